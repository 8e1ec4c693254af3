"""Other stacks on the machine are found by their processes, and the work of others by its time."""

from __future__ import annotations

import os
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
    neighbours.look([1], 0.0)
    assert neighbours.most == 0
    processes(
        proc, p1=robot, p2="python -m edge_node", p3="grep robot_node", p4="python robot_node"
    )
    neighbours.look([1], 0.0)
    assert neighbours.most == 0
    processes(
        proc, p1=robot, p5=robot, p6="python -m viewer record runs/a", p7="python -m viewer live"
    )
    neighbours.look([1], 0.0)
    assert neighbours.most == 2


def test_the_largest_number_counts_and_a_process_that_has_ended_does_no_harm(
    tmp_path: Path,
) -> None:
    proc = tmp_path / "proc"
    processes(proc, p5="python -m robot_node")
    neighbours = Neighbours(proc)
    neighbours.look([], 0.0)
    processes(proc, p8="sleep 1")
    (proc / "9").mkdir()
    neighbours.look([], 0.0)
    assert neighbours.most == 1


def test_the_cores_of_others_are_the_work_of_the_machine_without_ours(tmp_path: Path) -> None:
    per_s = os.sysconf("SC_CLK_TCK")
    neighbours = Neighbours(tmp_path)

    def look(now_s: float, *, machine_s: float, ours_s: float) -> None:
        # Work of the user, nice and system; idle and waiting; irq, softirq; taken by a hypervisor.
        user = int((machine_s - 4) * per_s)
        text = f"cpu  {user} {per_s} {per_s} 99999 99999 {per_s} 0 {per_s} 5 5\ncpu0 1\n"
        (tmp_path / "stat").write_text(text)
        (tmp_path / "7").mkdir(exist_ok=True)
        fields = ["S", *["0"] * 10, str(int(ours_s * per_s)), "0", *["0"] * 10]
        (tmp_path / "7" / "stat").write_text(f"7 (a ) b) {' '.join(fields)}\n")
        neighbours.look([7, 8], now_s)

    look(10.0, machine_s=100.0, ours_s=1.0)
    assert neighbours.cores is None
    look(12.0, machine_s=103.0, ours_s=2.0)
    assert neighbours.cores == 1.0
    # A process of ours that has ended has done its work.
    (tmp_path / "7" / "stat").unlink()
    look(14.0, machine_s=105.0, ours_s=3.0)
    assert neighbours.cores == 0.75


def test_a_system_without_proc_knows_nothing(tmp_path: Path) -> None:
    neighbours = Neighbours(tmp_path / "none")
    neighbours.look([1], 0.0)
    neighbours.look([1], 1.0)
    assert (neighbours.most, neighbours.cores) == (0, None)
