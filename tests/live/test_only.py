"""Parts of the stack started apart, as on several machines: here all on loopback."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.processes import Process, descendants_naming, until
from tests.telemetry_hub import TelemetryHub

pytestmark = pytest.mark.live

Start = Callable[..., Process]

ROBOT = ("--duration", "1", "--push", "none")


def test_an_edge_alone_serves_robot_after_robot_until_it_is_told_to_end(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    edge = start(
        "deploy", "up", "--only", "edge", "--listen", endpoints[0], "--out", str(tmp_path / "edge")
    )
    edge.wait_for("READY")
    assert "for this machine only" in edge.output
    out = tmp_path / "robot"
    robot = start(
        "deploy", "up", "--only", "robot", *ROBOT, "--edge", endpoints[0], "--out", str(out)
    )
    assert robot.wait() == 0, robot.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["network"] == "direct"
    assert summary["link"]["downlink"]["received"] > 0
    assert (out / "recording.rrd").exists()
    out = tmp_path / "another"
    another = start(
        "robot_node", *ROBOT, "--connect", endpoints[0], "--controller", "lc", "--out", str(out)
    )
    assert another.wait() == 0, another.output
    assert json.loads((out / "telemetry.json").read_text())["link"]["downlink"]["received"] > 0
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    assert edge.output.count("a robot is sending states") >= 1
    report = json.loads((tmp_path / "edge/edge.json").read_text())
    assert report["link"]["uplink"]["received"] > 1000
    assert descendants_naming(str(tmp_path)) == []


def test_settings_that_differ_are_named_at_both_ends(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    edge = start("edge_node", "--listen", endpoints[0])
    edge.wait_for("READY")
    # Longer where the robot has to give up before any of its states has come to the edge.
    for seconds in (2, 10, 50):
        config = tmp_path / f"stiff-{seconds}.toml"
        config.write_text(f"[wbc.gains]\nposture = 11.0\n[loop]\nconnect_timeout = {seconds}.0\n")
        robot = start("robot_node", "--connect", endpoints[0], "--config", str(config))
        assert robot.wait() == 2
        if "refuses a robot's states" in edge.output:
            break
    assert f"no usable answer from the edge within {seconds} s" in robot.output
    assert endpoints[0] in robot.lines[-1]
    assert "task, robot, wbc and walk settings" in robot.lines[-1]
    assert "refuses a robot's states (config)" in edge.output


def test_robot_and_edge_meet_at_a_router_that_comes_back_after_it_was_gone(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    def router(number: int) -> Process:
        out = str(tmp_path / f"router-{number}")
        started = start("deploy", "up", "--only", "router", "--listen", endpoints[0], "--out", out)
        started.wait_for("READY")
        return started

    first = router(1)
    edge = start(
        *("deploy", "up", "--only", "edge", "--router", endpoints[0], "--name", "amy"),
        *("--out", str(tmp_path / "edge")),
    )
    edge.wait_for("READY")
    robot = start(
        *("robot_node", "--connect", endpoints[0], "--name", "amy"),
        *("--controller", "lc", "--duration", "3600", "--push", "none"),
    )
    robot.wait_for("the task begins")
    first.signal(signal.SIGTERM)
    assert first.wait() == 0, first.output
    robot.wait_for("no answer for")
    router(2)
    robot.wait_for("new answers again")
    robot.signal(signal.SIGINT)
    assert robot.wait() == 130, robot.output
    assert robot.lines[-1].startswith("stands after"), robot.output


def test_robots_of_one_kind_with_names_of_their_own_do_not_hear_each_other(
    start: Start, hub: Callable[[], TelemetryHub], endpoints: list[str], tmp_path: Path
) -> None:
    start("deploy.router", "--listen", endpoints[0]).wait_for("READY")
    robots = []
    for name in ("amy", "ben"):
        start("edge_node", "--connect", endpoints[0], "--name", name).wait_for("READY")
    for name in ("amy", "ben"):
        flags = ["--connect", endpoints[0], "--name", name, "--out", str(tmp_path / name)]
        flags += ["--controller", "lc", "--duration", "3600", "--push", "none"]
        watched = hub()
        robots.append((name, start("robot_node", *flags, "--telemetry", watched.endpoint), watched))
    for _, robot, _ in robots:
        robot.wait_for("the task begins")
    # A second of both at the same time.
    until_ns = [watched.last("time_ns") + 1e9 for _, _, watched in robots]
    until(
        lambda: all(
            watched.last("time_ns") > end_ns
            for (_, _, watched), end_ns in zip(robots, until_ns, strict=True)
        ),
        lambda: "\n".join(robot.output for _, robot, _ in robots),
    )
    for name, robot, _ in robots:
        robot.signal(signal.SIGINT)
        assert robot.wait() == 130, robot.output
        assert robot.lines[-1].startswith("stands after"), robot.output
        report = json.loads((tmp_path / name / "telemetry.json").read_text())
        # An answer to the other robot would be refused under `session`.
        assert report["link"]["downlink"]["refused"] == {}
