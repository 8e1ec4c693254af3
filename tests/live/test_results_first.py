"""A process ends with its results, also beside a frozen neighbour, a cut cable or a full disk."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.faults.stacks import rows_in
from benchmarks.link_paths import free_endpoints
from benchmarks.real_path.namespaces import Machine, Machines, two_machines
from netem.networks import load_profile
from netem.profile import LOST
from shared.errors import UserError
from shared.output.summary import summary_in_words
from shared.telemetry.parquet import parquet_shape, read_parquet
from tests.processes import Process, until

pytestmark = pytest.mark.live

Start = Callable[..., Process]

# `netem record` that says more often than every five seconds how it gets on.
TALKATIVE = """
from netem.__main__ import main
from shared.output import screen
from shared.process.cli import run
screen._PLAIN_SECONDS = 0.6
run(main)
"""


@pytest.fixture
def machines() -> Iterator[Machines]:
    """Two machines on a cable. Ask for it before `start`."""
    with contextlib.ExitStack() as stack:
        try:
            joined = stack.enter_context(two_machines(rate="1gbit"))
        except UserError as error:
            pytest.skip(str(error))
        yield joined


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """The folder of a disk of 2 MB. Ask for it before `start`."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ("mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk))
    made = subprocess.run(mount, capture_output=True, text=True, check=False)
    if made.returncode != 0:
        pytest.skip(f"no disk of limited size: {made.stderr.strip()}")
    yield disk
    subprocess.run(("umount", "--lazy", str(disk)), check=True)


def begin(start: Start, out: Path, *robot: str) -> tuple[Process, Process]:
    """An edge and a robot whose task has begun."""
    (endpoint,) = free_endpoints(1)
    edge = start("edge_node", "--listen", endpoint, "--out", str(out))
    edge.wait_for("READY")
    given = ("--duration", "3600", "--push", "none", "--out", str(out))
    standing = start("robot_node", "--connect", endpoint, *given, *robot)
    standing.wait_for("the task begins")
    return edge, standing


def record_for_an_hour(
    start: Start, endpoint: str, out: Path, *, machine: Machine | None = None
) -> Process:
    recording = ("record", "--connect", endpoint, "--out", str(out), "--seconds", "3600")
    return start("-c", TALKATIVE, *recording, machine=machine)


def test_a_robot_whose_edge_is_frozen_ends_with_its_outcome(start: Start, tmp_path: Path) -> None:
    edge, robot = begin(start, tmp_path, "--controller", "lc")
    edge.signal(signal.SIGSTOP)
    robot.wait_for("no answer for")
    # Until the kernel's and Zenoh's buffers towards the edge are full: some thousand states.
    before = rows_in(tmp_path / "telemetry.rows")
    until(lambda: rows_in(tmp_path / "telemetry.rows") > before + 3000, lambda: robot.output)
    robot.signal(signal.SIGINT)
    assert robot.wait() == 130, robot.output
    edge.signal(signal.SIGCONT)
    assert robot.lines[-1].startswith("stands after"), robot.output
    assert json.loads((tmp_path / "telemetry.json").read_text())["fell"] is False
    assert parquet_shape(tmp_path / "telemetry.parquet")[1] > 3000


def test_an_edge_whose_robot_is_frozen_ends_with_its_outcome(start: Start, tmp_path: Path) -> None:
    edge, robot = begin(start, tmp_path)
    robot.signal(signal.SIGSTOP)
    edge.wait_for("no states for 1 s")
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    robot.signal(signal.SIGCONT)
    assert edge.lines[-1].startswith("stopped: "), edge.output
    assert parquet_shape(tmp_path / "edge.parquet")[1] > 0


def test_a_shim_whose_edge_is_frozen_ends_with_its_outcome(start: Start, tmp_path: Path) -> None:
    far, near = free_endpoints(2)
    edge = start("edge_node", "--listen", far)
    edge.wait_for("READY")
    shim = start(
        *("netem", "replay", "constant:4ms", "--listen", near, "--connect", far),
        *("--out", str(tmp_path)),
    )
    shim.wait_for("READY")
    robot = start(
        *("robot_node", "--connect", near, "--controller", "lc", "--push", "none"),
        *("--duration", "3600", "--out", str(tmp_path / "robot")),
    )
    robot.wait_for("the task begins")
    edge.signal(signal.SIGSTOP)
    # The shim waits for room towards the edge, while states wait in the shim.
    sent = tmp_path / "robot/telemetry.rows"
    before = rows_in(sent)
    until(lambda: rows_in(sent) > before + 6000, lambda: robot.output)
    shim.signal(signal.SIGTERM)
    assert shim.wait() == 0, shim.output
    edge.signal(signal.SIGCONT)
    assert shim.lines[-1].startswith("stopped: "), shim.output
    assert parquet_shape(tmp_path / "link.parquet")[1] > 500


def test_a_recording_whose_far_end_is_frozen_keeps_what_was_measured(
    start: Start, tmp_path: Path
) -> None:
    (endpoint,) = free_endpoints(1)
    far = start("netem", "record", "--listen", endpoint)
    far.wait_for("READY")
    out = tmp_path / "mylink.npz"
    near = record_for_an_hour(start, endpoint, out)
    near.wait_for("lost or late", times=1)
    far.signal(signal.SIGSTOP)
    near.wait_for("lost or late", times=3)
    near.signal(signal.SIGINT)
    assert near.wait() == 0, near.output
    far.signal(signal.SIGCONT)
    for delays in load_profile(str(out)).delays_ns:
        assert np.any(delays != LOST)
        assert np.all(delays[-500:] == LOST)


def test_both_ends_of_a_cable_that_is_cut_end_with_their_results(
    machines: Machines, start: Start, tmp_path: Path
) -> None:
    endpoint = f"tcp/{machines.edge.address}:7460"
    edge = start(
        *("edge_node", "--listen", endpoint, "--out", str(tmp_path / "edge")),
        machine=machines.edge,
    )
    edge.wait_for("READY")
    robot = start(
        *("robot_node", "--connect", endpoint, "--controller", "lc", "--push", "none"),
        *("--duration", "3600", "--out", str(tmp_path / "robot")),
        machine=machines.robot,
    )
    robot.wait_for("the task begins")
    machines.cut()
    robot.wait_for("no answer for")
    rows = tmp_path / "robot/telemetry.rows"
    before = rows_in(rows)
    until(lambda: rows_in(rows) > before + 3000, lambda: robot.output)
    for process in (robot, edge):
        process.signal(signal.SIGINT)
    assert robot.wait() == 130, robot.output
    assert edge.wait() == 0, edge.output
    assert robot.lines[-1].startswith("stands after"), robot.output
    assert edge.lines[-1].startswith("stopped: "), edge.output
    assert parquet_shape(tmp_path / "robot/telemetry.parquet")[1] > 3000
    assert parquet_shape(tmp_path / "edge/edge.parquet")[1] > 0


def test_a_recording_over_a_cable_that_is_cut_keeps_what_was_measured(
    machines: Machines, start: Start, tmp_path: Path
) -> None:
    endpoint = f"tcp/{machines.edge.address}:7460"
    far = start("netem", "record", "--listen", endpoint, machine=machines.edge)
    far.wait_for("READY")
    out = tmp_path / "mylink.npz"
    near = record_for_an_hour(start, endpoint, out, machine=machines.robot)
    near.wait_for("lost or late", times=1)
    machines.cut()
    near.wait_for("lost or late", times=3)
    for process in (near, far):
        process.signal(signal.SIGINT)
        assert process.wait() == 0, process.output
    assert far.lines[-1].startswith("stopped; "), far.output
    for delays in load_profile(str(out)).delays_ns:
        assert np.any(delays != LOST)
        assert np.all(delays[-500:] == LOST)


def test_a_full_disk_hides_no_outcome(small_disk: Path, start: Start) -> None:
    up = start(
        *("deploy", "up", "--controller", "lc", "--view", "off", "--push", "none"),
        *("--network", "constant:10ms", "--duration", "5", "--out", str(small_disk / "run")),
    )
    assert up.wait() == 0, up.output
    full = [line for line in up.lines if "No space left on device" in line]
    assert any("cannot write all of telemetry's files" in line for line in full), up.output
    assert "Stands after 5.00 s" in up.output
    summary = json.loads((small_disk / "run/summary.json").read_text())
    assert (summary["fell"], summary["task_seconds"]) == (False, 5.0)
    state = json.loads((small_disk / "run/stack/state").read_text())
    assert (state["state"], state["exit_code"]) == ("ended", 0)
    assert state["outcome"] == summary_in_words(summary).splitlines()[0]
    # What the disk had room for is there, in one form or the other.
    assert rows_in(small_disk / "run/telemetry.rows") > 0


def test_a_limit_of_file_sizes_hides_no_outcome(start: Start, tmp_path: Path) -> None:
    out = tmp_path / "run"
    arguments = "up --controller lc --view off --push none --network constant:10ms --duration 3"
    limited = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000)); "
        f"import sys; sys.argv[1:] = {[*arguments.split(), '--out', str(out)]!r}; "
        "import deploy.outcome; deploy.outcome._IDLE_SECONDS = 3.0; "  # of a recorder that is stuck
        "from deploy.__main__ import main; from shared.process.cli import run; run(main)"
    )
    up = start("-c", limited)
    assert up.wait() == 0, up.output
    assert any("File too large" in line for line in up.lines), up.output
    assert json.loads((out / "summary.json").read_text())["fell"] is False


def test_the_rows_of_a_killed_robot_are_recovered(start: Start, tmp_path: Path) -> None:
    edge, robot = begin(start, tmp_path, "--controller", "lc")
    until(lambda: rows_in(tmp_path / "telemetry.rows") > 500, lambda: robot.output)
    robot.signal(signal.SIGKILL)
    robot.wait()
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    opened = start("viewer", "record", str(tmp_path))
    # It is no run of `up`, so it has no settings; its rows are a table all the same.
    assert opened.wait() == 2, opened.output
    schema, rows = read_parquet(tmp_path / "telemetry.parquet")
    assert len(rows) >= 500
    assert np.all(np.diff(schema.column(rows, "tick")) == 1)
    assert not (tmp_path / "telemetry.rows").exists()
