"""A stack in the background: started, looked at, one service again, ended; nothing is left."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import stat
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.faults.stacks import rows_in
from deploy.background.registry import registry_folder
from deploy.background.state import READY, ServiceState, StackFolder
from shared.process.entry import python
from tests.processes import ROOT, Process, descendants_naming, played, until

pytestmark = pytest.mark.live

Start = Callable[..., Process]
# The robot's name on the link: this test's stacks are nobody else's.
NAME = f"test-{os.getpid()}"
QUIET = ("--controller", "lc", "--push", "none", "--view", "off")


@pytest.fixture(autouse=True)
def left_behind() -> Iterator[None]:
    """Whatever became of the test, its stacks end and are forgotten."""
    yield
    message("down")
    for link in registry_folder().glob(f"{NAME}.*"):
        link.unlink()


def message(command: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """What a command of `deploy/` says, and its exit code."""
    return played(str(ROOT / "deploy" / command), *arguments, "--name", NAME)


def up(*arguments: str) -> subprocess.CompletedProcess[str]:
    return played(*python("-m", "deploy", "up", "-d", "--name", NAME, *arguments))


def ports_of(run: Path) -> list[int]:
    """Where its services have listened."""
    logs = "".join(file.read_text() for file in run.glob("*.log"))
    ports = [int(port) for port in re.findall(r"^READY tcp/127\.0\.0\.1:(\d+)", logs, re.M)]
    assert ports
    return ports


def until_nobody_names(run: Path) -> None:
    until(
        lambda: not descendants_naming(str(run)),
        lambda: f"processes {descendants_naming(str(run))} are left of {run}",
    )


def assert_nothing_is_left(run: Path, ports: list[int]) -> None:
    until_nobody_names(run)
    assert not StackFolder(run).alive
    assert not (run / "stack/control").is_socket()
    for port in ports:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", port))


def test_a_stack_in_the_background_from_its_start_to_its_end(start: Start, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert message("ps").stdout == "nothing is running\n"
    started = up(*QUIET, "--network", "constant:10ms", "--duration", "600", "--out", str(run))
    assert started.returncode == 0, started.stdout + started.stderr
    assert " robot | READY" in started.stdout
    assert "\x1b" not in started.stdout
    ports = ports_of(run)
    # Another user reaches neither the locks nor the sockets.
    assert stat.S_IMODE((run / "stack").stat().st_mode) == 0o700
    for name in ("lock", "state", "hub", "control"):
        assert stat.S_IMODE((run / "stack" / name).stat().st_mode) == 0o600
    assert stat.S_IMODE((run / "telemetry.rows").stat().st_mode) == 0o600

    shown = message("ps")
    assert shown.returncode == 0
    table = [line.split() for line in shown.stdout.splitlines()[2:]]
    assert [(row[0], row[2]) for row in table] == [
        ("edge", "ready"),
        ("netem", "ready"),
        ("robot", "ready"),
    ]
    for row in table:
        assert int(row[1]) in descendants_naming(str(run))

    second = up(*QUIET, "--out", str(tmp_path / "second"))
    assert second.returncode == 2
    assert f"edge, netem, robot of {NAME} run already" in second.stderr
    assert not (tmp_path / "second").exists()
    assert len(second.stderr.splitlines()) == 1

    following = start("deploy", "logs", "-f", "robot", "--run", str(run))
    following.wait_for("the task begins")
    again = message("restart", "edge")
    assert again.returncode == 0, again.stderr
    # The robot has stood on what it had, and gets new answers.
    following.wait_for("new answers again")
    assert message("ps").stdout.splitlines()[2].split()[-1] == "1"
    refused = message("restart", "robot")
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1

    ended = message("down")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "Stands after" in ended.stdout
    assert following.wait() == 0
    assert_nothing_is_left(run, ports)
    summary = json.loads((run / "summary.json").read_text())
    assert summary["fell"] is False
    # What both edges have done is in it, and in the log.
    assert (run / "edge.1.parquet").exists()
    logged = message("logs").stdout
    assert logged.count("  edge | READY") == 2
    assert "edge started again 1 ×" in logged


def test_a_stack_whose_robot_falls_ends_by_itself_and_says_so_later(
    start: Start, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    flags = ("--controller", "pr", "--network", "constant:120ms", "--view", "off")
    started = up(*flags, "--out", str(run))
    assert started.returncode == 0, started.stdout + started.stderr
    following = start("deploy", "logs", "-f", "--run", str(run))
    assert following.wait() == 0
    assert "FELL after" in following.output
    # On a busy machine it may fall before its push.
    assert " robot | first answer received" in following.output
    shown = message("ps")
    assert shown.returncode == 0
    assert shown.stdout.startswith("nothing is running\n")
    assert "(exit 3): FELL after" in shown.stdout
    assert message("down").returncode == 3
    assert_nothing_is_left(run, ports_of(run))


def test_a_busy_port_is_one_line_and_a_killed_supervisor_leaves_no_orphan(
    endpoints: list[str], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    edge = ("--only", "edge", "--listen", endpoints[0])
    assert up(*edge, "--out", str(run)).returncode == 0
    port = endpoints[0].rpartition(":")[2]
    second = up(*edge, "--out", str(tmp_path / "second"))
    assert second.returncode == 2
    assert f"port {port} is in use" in second.stderr
    assert len(second.stderr.splitlines()) == 1
    assert not (tmp_path / "second").exists()

    os.kill(StackFolder(run).read().pid, signal.SIGKILL)
    until_nobody_names(run)
    assert "its supervisor was killed" in message("ps").stdout
    assert message("down").returncode == 2
    (run / "stack/control").unlink()
    assert_nothing_is_left(run, [int(port)])


def test_an_edge_that_crashes_again_and_again_is_degraded_and_the_robot_stands(
    tmp_path: Path,
) -> None:
    run = tmp_path / "run"
    started = up(*QUIET, "--network", "direct", "--duration", "3600", "--out", str(run))
    assert started.returncode == 0, started.stdout + started.stderr
    stack = StackFolder(run)

    def edge() -> ServiceState:
        return stack.read().services[0]

    for crashes in range(4):
        until(lambda: edge().state == READY, lambda: message("logs").stdout)
        assert edge().restarts == crashes
        os.kill(edge().pid, signal.SIGKILL)
        until(lambda: edge().state != READY, lambda: message("logs").stdout)
    until(lambda: edge().degraded, lambda: message("logs").stdout)
    shown = message("ps").stdout
    assert "ready (edge degraded) since" in shown
    until(lambda: edge().state == READY, lambda: message("logs").stdout)
    assert message("down").returncode == 0
    summary = json.loads((run / "summary.json").read_text())
    assert summary["fell"] is False
    assert summary["services"]["edge"]["restarts"] == 4
    assert summary["services"]["edge"]["degraded_seconds"] >= 1.0
    assert "edge started again 4 ×, degraded for" in message("logs").stdout
    # Four lives were killed, and their rows count too.
    assert {f"edge.{number}.parquet" for number in range(1, 5)} <= {
        file.name for file in run.glob("edge.*.parquet")
    }
    assert_nothing_is_left(run, [])


def test_a_run_that_is_killed_as_a_whole_is_summed_up_by_the_next_command(tmp_path: Path) -> None:
    run = tmp_path / "run"
    started = up(*QUIET, "--network", "constant:10ms", "--duration", "3600", "--out", str(run))
    assert started.returncode == 0, started.stdout + started.stderr
    until(lambda: rows_in(run / "telemetry.rows") > 500, lambda: message("logs").stdout)
    state = StackFolder(run).read()
    # Before the services hear of it.
    for pid in (*(service.pid for service in state.services), state.pid):
        os.kill(pid, signal.SIGKILL)
    until_nobody_names(run)
    shown = message("ps").stdout
    assert re.search(r"its supervisor was killed; Killed after \d+\.\d\d s of balance", shown), (
        shown
    )
    summary = json.loads((run / "summary.json").read_text())
    assert summary["task_seconds"] > 0.0
    assert (run / "telemetry.parquet").exists()
    assert not list(run.glob("*.rows"))
    assert message("down").returncode == 2
    assert played(*python("-m", "viewer", "record", str(run))).returncode == 0
