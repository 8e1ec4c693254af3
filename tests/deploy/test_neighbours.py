"""Other stacks on the machine are found by their processes."""

from __future__ import annotations

from pathlib import Path

from deploy.neighbours import Neighbours


def processes(proc: Path, **commands: str) -> None:
    """Make a /proc with these commands; a name is `p` and the process number."""
    proc.mkdir(exist_ok=True)
    for folder in proc.iterdir():
        (folder / "cmdline").unlink(missing_ok=True)
        folder.rmdir()
    for name, command in commands.items():
        (proc / name[1:]).mkdir()
        (proc / name[1:] / "cmdline").write_bytes(command.replace(" ", "\0").encode() + b"\0")


def test_robots_and_recordings_of_others_count_and_ours_do_not(tmp_path: Path) -> None:
    proc = tmp_path / "proc"
    robot = "python -I -m robot_node --connect tcp/127.0.0.1:7461"
    neighbours = Neighbours(proc)
    neighbours.look([1])
    assert neighbours.most == 0
    processes(
        proc, p1=robot, p2="python -m edge_node", p3="grep robot_node", p4="python robot_node"
    )
    neighbours.look([1])
    assert neighbours.most == 0
    processes(
        proc, p1=robot, p5=robot, p6="python -m viewer record runs/a", p7="python -m viewer live"
    )
    neighbours.look([1])
    assert neighbours.most == 2


def test_the_largest_number_counts_and_a_process_that_has_ended_does_no_harm(
    tmp_path: Path,
) -> None:
    proc = tmp_path / "proc"
    processes(proc, p5="python -m robot_node")
    neighbours = Neighbours(proc)
    neighbours.look([])
    processes(proc, p8="sleep 1")
    (proc / "9").mkdir()
    neighbours.look([])
    assert neighbours.most == 1
