"""The three processes on loopback: delivery, safety, files, exit codes. Never microseconds."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from shared.bus.base import Delivery
from shared.bus.zenoh_bus import ZenohBus
from shared.config.config_file import load_config
from shared.config.robot_settings import RobotConfig
from shared.config.settings import RunConfig
from shared.process.entry import python
from shared.robots import load_robot
from shared.telemetry.parquet import read_parquet
from shared.telemetry.schema import STEP_SCHEMA
from shared.wire.channels import DOWNLINK
from tests.processes import ROOT, Process, descendants_naming, ended, until
from tests.telemetry_hub import TelemetryHub, is_heard
from tests.viewer.reading import logged

pytestmark = pytest.mark.live

Start = Callable[..., Process]

SUMMARY_KEYS = {
    "fell",
    "com_error_m",
    "contact_violation_m_s2",
    "commands",
    "projector_age_ms",
    "link",
    "edge_solve_ms",
    "robot_tick_ms",
    "overruns",
    "realtime_factor",
    "log_hash",
    "versions",
}


# An edge that has loaded what it needs, and begins when there is a file: its first argument.
LOADED_EDGE = """
import pathlib, sys, time
from edge_node.__main__ import main
from shared.process.cli import run
print("loaded", flush=True)
begin = pathlib.Path(sys.argv.pop(1))
while not begin.exists():
    time.sleep(0.01)
run(main)
"""


def short_walk(tmp_path: Path) -> tuple[str, ...]:
    """Options of a walk of two steps and 3 s."""
    config = tmp_path / "walk.toml"
    config.write_text("[walk]\nsteps = 2\nbegin_duration = 0.6\nend_duration = 0.8\n")
    return ("--task", "walk", "--config", str(config))


# The others balance in simulated time, and each is converted for the viewer in tests of the viewer.
@pytest.mark.parametrize("robot", [RobotConfig.name, "g1"])
def test_up_balances_and_leaves_every_file(start: Start, tmp_path: Path, robot: str) -> None:
    out = tmp_path / "run"
    up = start(
        "deploy",
        "up",
        *("--robot", robot),
        *("--view", "off", "--duration", "1.5", "--network", "constant:10ms"),
        *("--push", "none", "--out", str(out)),
    )
    assert up.wait() == 0, up.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary.keys() >= SUMMARY_KEYS
    assert summary["fell"] is False
    assert sum(summary["commands"].values()) == 1500
    assert summary["link"]["uplink"]["sent"] >= 1500
    for way in ("uplink", "downlink"):
        assert summary["link"][way]["refused"] == {}
        assert summary["link"][way]["received"] > 0
        assert summary["link"][way]["dropped_by_profile"] == 0
    # Nothing can come back sooner than the link's round trip.
    assert summary["projector_age_ms"]["p50"] > 10.0
    schema, rows = read_parquet(out / "telemetry.parquet")
    times = schema.column(rows, "time_ns")
    times = times[times >= 0]
    assert np.array_equal(np.diff(times), np.full(len(times) - 1, 1_000_000))
    schema, rows = read_parquet(out / "link.parquet")
    assert np.all(schema.column(rows, "achieved_ns") >= schema.column(rows, "nominal_ns"))
    assert (out / "recording.rrd").stat().st_size > 10_000
    config = load_config(out / "config.toml")
    assert config.link.network == "constant:10ms"
    for name in ("edge.log", "netem.log", "robot.log", "edge.parquet"):
        assert (out / name).exists(), name
    assert descendants_naming(str(out)) == []


def test_up_walks_with_an_on_board_computer_beside_the_loop(start: Start, tmp_path: Path) -> None:
    out = tmp_path / "run"
    up = start(
        "deploy",
        "up",
        *(*short_walk(tmp_path), "--network", "constant:10ms"),
        *("--view", "off", "--out", str(out)),
    )
    assert up.wait() == 0, up.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["fell"] is False
    assert sum(summary["commands"].values()) == 3000
    # Two preparations per step, and full QPs in the windows around the switches.
    assert summary["on_board_qps"] > 4
    assert summary["active_set_discrepancy"]["mean"] is not None
    assert descendants_naming(str(out)) == []


def test_up_records_the_footprints_of_a_robot_that_steps(start: Start, tmp_path: Path) -> None:
    out, config = tmp_path / "run", tmp_path / "stepping.toml"
    config.write_text('[wbc.balance]\nlaw = "dcm"\n')
    up = start(
        "deploy",
        "up",
        *("--controller", "lc", "--stepping", "on", "--config", str(config)),
        *("--network", "constant:10ms", "--push", "none", "--duration", "1"),
        *("--view", "off", "--out", str(out)),
    )
    assert up.wait() == 0, up.output
    _, rows = read_parquet(out / "steps.parquet")
    # The feet as the robot begins: it does not step.
    assert STEP_SCHEMA.column(rows, "foot").tolist() == [0, 1]
    (soles,) = logged(out / "recording.rrd", "/world/landed_soles", "LineStrips3D:strips")[1]
    assert len(soles) == 2


def test_up_walks_on_with_the_link_cut(start: Start, tmp_path: Path) -> None:
    out = tmp_path / "run"
    up = start(
        "deploy",
        "up",
        *(*short_walk(tmp_path), "--controller", "lc", "--network", "constant:20ms"),
        *("--outage", "cut@1s", "--view", "off", "--out", str(out)),
    )
    assert up.wait() == 0, up.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["fell"] is False
    assert summary["commands"]["corrected"] == 3000
    assert summary["link"]["uplink"]["dropped_by_profile"] > 1500
    # A factorisation now and then, not one a millisecond.
    assert 0 < summary["link"]["downlink"]["sent"] < 300
    assert "no answer for" in up.output


def test_a_plan_that_cannot_be_walked_is_refused_before_anything_starts(
    start: Start, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    up = start("deploy", "up", "--task", "walk", "--step-sideways", "0.5", "--out", str(out))
    assert up.wait() == 2
    assert len(up.lines) == 1
    assert "legs reach" in up.output
    assert not out.exists()


def test_up_says_with_its_exit_code_that_the_robot_fell(start: Start, tmp_path: Path) -> None:
    up = start(
        "deploy",
        "up",
        *("--view", "off", "--controller", "pr", "--network", "constant:120ms"),
        *("--out", str(tmp_path / "run")),
    )
    assert up.wait() == 3, up.output
    assert json.loads((tmp_path / "run/summary.json").read_text())["fell"] is True
    assert "FELL" in up.output


# With other signals: tests/deploy/test_stack.py.
def test_interrupted_up_stops_everything_and_keeps_what_was_measured(
    start: Start, tmp_path: Path
) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        pytest.skip("SIGINT is ignored by what started the tests, as in the background of a shell")
    out = tmp_path / "run"
    up = start("deploy", "up", "--view", "off", "--duration", "3600", "--out", str(out))
    up.wait_for("the task begins")
    up.signal(signal.SIGINT)
    assert up.wait() == 130, up.output
    assert json.loads((out / "summary.json").read_text())["task_seconds"] > 0.0
    assert descendants_naming(str(out)) == []


def test_whoever_reads_its_output_may_leave_and_the_run_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = python("-m", "deploy", "up", "--controller", "lc", "--view", "off")
    command += ["--duration", "1", "--push", "none", "--out", str(out)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as up:
        assert up.stdout is not None
        up.stdout.readline()
        up.stdout.close()
        try:
            assert ended(up) == 0
        finally:
            up.terminate()
    assert json.loads((out / "summary.json").read_text())["task_seconds"] == 1.0
    assert "Stands after" in (out / "stack/log").read_text()
    assert descendants_naming(str(out)) == []


# The robot's: tests/deploy/test_stack.py.
def test_death_of_a_service_ends_the_run_with_its_name(start: Start, tmp_path: Path) -> None:
    out = tmp_path / "run"
    up = start("deploy", "up", "--view", "off", "--duration", "3600", "--out", str(out))
    up.wait_for("the task begins")
    victim = [pid for pid in descendants_naming(str(out)) if _module(pid) == "netem"]
    assert len(victim) == 1
    os.kill(victim[0], signal.SIGKILL)
    assert up.wait() == 2, up.output
    assert "error: netem ended (signal 9)" in up.output
    assert "NO RESULT about the link: netem ended (signal 9)" in up.output
    result = json.loads((out / "summary.json").read_text())
    assert result["valid"] is False
    assert result["invalid_reasons"][0] == "netem ended (signal 9)"
    assert descendants_naming(str(out)) == []


def test_robot_balances_on_its_cache_while_the_edge_is_dead(
    start: Start, hub: Callable[[], TelemetryHub], endpoints: list[str], tmp_path: Path
) -> None:
    edge = start("edge_node", "--listen", endpoints[0])
    shim = start(
        *("netem", "replay", "constant:4ms"),
        *("--listen", endpoints[1], "--connect", endpoints[0]),
    )
    edge.wait_for("READY")
    shim.wait_for("READY")
    # Minutes on held joints are more than the robot is made for, and loading may take them.
    begin = tmp_path / "begin"
    another = start("-c", LOADED_EDGE, str(begin), "--listen", endpoints[0])
    another.wait_for("loaded")
    watched = hub()
    robot = start(
        *("robot_node", "--connect", endpoints[1], "--telemetry", watched.endpoint),
        *("--duration", "3600", "--push", "none", "--out", str(tmp_path)),
    )
    robot.wait_for("the task begins")
    edge.signal(signal.SIGKILL)
    robot.wait_for("going on with the cache")
    begin.touch()
    robot.wait_for("new answers again")
    until(
        lambda: 0 < watched.newest("projector_age_ns").max(initial=-1) < 250e6,
        lambda: f"the projector stays old:\n{robot.output}",
    )
    robot.signal(signal.SIGINT)
    assert robot.wait() == 130, robot.output
    assert robot.lines[-1].startswith("stands after"), robot.output
    schema, rows = read_parquet(tmp_path / "telemetry.parquet")
    age_ms = schema.column(rows, "projector_age_ns") * 1e-6
    assert age_ms.max() > 250.0
    after = age_ms[np.argmax(age_ms) :]
    newest = np.lib.stride_tricks.sliding_window_view(after, 100).max(axis=1)
    assert newest.min() < 250.0
    assert np.all(np.isfinite(schema.column(rows, "tau")))


def test_bad_messages_on_the_robots_key_are_counted_and_have_no_effect(
    start: Start, hub: Callable[[], TelemetryHub], endpoints: list[str], tmp_path: Path
) -> None:
    config = RunConfig()
    robot_model = load_robot(config.robot.name)
    watched = hub()
    edge = start("edge_node", "--listen", endpoints[0])
    edge.wait_for("READY")
    robot = start(
        # With answers to every state a slow machine would lose some of these messages.
        *("robot_node", "--connect", endpoints[0], "--controller", "lc"),
        *("--telemetry", watched.endpoint),
        *("--duration", "3600", "--push", "none", "--out", str(tmp_path)),
    )
    robot.wait_for("the task begins")
    rogue = ZenohBus(connect=[endpoints[0]], mode="client")
    try:
        # Its own queue is not to lose any of them.
        key = DOWNLINK.key_for(robot_model.name)
        stranger = rogue.publisher(key, wait_when_full=True)
        until(lambda: is_heard(stranger), "the rogue does not find the robot")
        until(lambda: watched.last("refused") >= 0, "the robot publishes nothing")
        refused = watched.last("refused")
        for _ in range(20):
            for data in (b"garbage", b"", bytes(50_000)):
                stranger.forward(Delivery(data, envelope=None))
            refused += 3

            def counted(expected: float = refused) -> bool:
                return watched.last("refused") >= expected

            until(
                counted,
                lambda: f"{watched.last('refused'):.0f} refused:\n{robot.output}",
            )
        # Should others have been refused meanwhile, the last of these may be on their way.
        tick = watched.last("tick") + 200
        until(lambda: watched.last("tick") > tick, lambda: robot.output)
        for reason in ("undecodable", "oversized"):
            robot.wait_for(f"refuses messages on its key ({reason})")
    finally:
        rogue.close()
    robot.signal(signal.SIGINT)
    assert robot.wait() == 130, robot.output
    assert robot.lines[-1].startswith("stands after"), robot.output
    report = json.loads((tmp_path / "telemetry.json").read_text())
    refused = report["link"]["downlink"]["refused"]
    assert refused.get("undecodable", 0) == 40
    assert refused.get("oversized", 0) == 20
    assert report["commands"]["held"] == 0
    limit = config.robot.torque_clamp * robot_model.effort_limit
    schema, rows = read_parquet(tmp_path / "telemetry.parquet")
    assert np.all(np.abs(schema.column(rows, "tau")) <= limit + 1e-12)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("netem", "replay", "--listen", "127.0.0.1:1"), "expected PROTOCOL/HOST:PORT"),
        (("edge_node", "--listen", "tcp/192.0.2.1:7460"), "cannot open"),
        (("edge_node", "--listen", "tls/127.0.0.1:7460"), "add --secure"),
        (("robot_node", "--controller", "xx"), "expected one of la, lc, pr"),
    ],
)
def test_a_users_mistake_is_one_line_that_says_what_to_do(
    start: Start, arguments: tuple[str, ...], expected: str
) -> None:
    process = start(*arguments)
    assert process.wait() == 2, process.output
    assert len(process.lines) == 1, process.output
    assert expected in process.output


def test_a_port_in_use_is_one_line_and_leaves_nothing_running(start: Start) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        process = start("edge_node", "--listen", f"tcp/127.0.0.1:{port}")
        assert process.wait() == 2
    assert len(process.lines) == 1, process.output
    assert "in use" in process.output


def test_robot_without_an_edge_gives_up_with_a_reason(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    config = tmp_path / "impatient.toml"
    config.write_text("[loop]\nconnect_timeout = 1.0\n")
    robot = start("robot_node", "--connect", endpoints[0], "--config", str(config))
    assert robot.wait() == 2
    assert len(robot.lines) == 1, robot.output
    assert f"no connection within 1 s: {endpoints[0]} refuses connections" in robot.output


def _module(pid: int) -> str:
    command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    return command[command.index(b"-m") + 1].decode() if b"-m" in command else ""
