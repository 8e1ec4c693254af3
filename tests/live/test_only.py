"""Parts of the stack started apart, as on several machines: here all on loopback."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.live.conftest import Process, descendants_naming

pytestmark = pytest.mark.live

Start = Callable[..., Process]

ROBOT = ("--only", "robot", "--duration", "1", "--push", "none")


def test_an_edge_alone_serves_robot_after_robot_until_it_is_told_to_end(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    edge = start(
        "deploy.up", "--only", "edge", "--listen", endpoints[0], "--out", str(tmp_path / "edge")
    )
    edge.wait_for("READY")
    assert "for this machine only" in edge.output
    for number, controller in enumerate(("la", "lc")):
        out = tmp_path / f"robot-{number}"
        robot = start(
            "deploy.up",
            *(*ROBOT, "--edge", endpoints[0], "--controller", controller, "--out", str(out)),
        )
        assert robot.wait() == 0, robot.output
        summary = json.loads((out / "summary.json").read_text())
        assert summary["network"] == "direct"
        assert summary["link"]["downlink"]["received"] > 0
        assert (out / "recording.rrd").exists()
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    assert edge.output.count("a robot is sending states") >= 1
    report = json.loads((tmp_path / "edge/edge.json").read_text())
    assert report["link"]["uplink"]["received"] > 1000
    assert descendants_naming(str(tmp_path)) == []


def test_settings_that_differ_are_named_at_both_ends(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    config = tmp_path / "stiff.toml"
    config.write_text("[wbc.gains]\nposture = 11.0\n[loop]\nconnect_timeout = 2.0\n")
    edge = start("edge_node", "--listen", endpoints[0])
    edge.wait_for("READY")
    robot = start("robot_node", "--connect", endpoints[0], "--config", str(config))
    assert robot.wait() == 2
    assert "no projector from the edge within 2 s" in robot.output
    assert endpoints[0] in robot.lines[-1]
    assert "task, robot, wbc and walk settings" in robot.lines[-1]
    assert "refuses a robot's states (config)" in edge.output


def test_robot_and_edge_meet_at_a_router_that_comes_back_after_it_was_gone(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    def router(number: int) -> Process:
        out = str(tmp_path / f"router-{number}")
        started = start("deploy.up", "--only", "router", "--listen", endpoints[0], "--out", out)
        started.wait_for("READY")
        return started

    first = router(1)
    edge = start(
        *("deploy.up", "--only", "edge", "--router", endpoints[0], "--name", "amy"),
        *("--out", str(tmp_path / "edge")),
    )
    edge.wait_for("READY")
    robot = start(
        *("robot_node", "--connect", endpoints[0], "--name", "amy"),
        *("--controller", "lc", "--duration", "15", "--push", "none"),
    )
    robot.wait_for("the task begins")
    first.signal(signal.SIGTERM)
    assert first.wait() == 0, first.output
    robot.wait_for("no answer for")
    router(2)
    robot.wait_for("new answers again")
    assert robot.wait() == 0, robot.output


def test_robots_of_one_kind_with_names_of_their_own_do_not_hear_each_other(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    start("deploy.router", "--listen", endpoints[0]).wait_for("READY")
    robots = []
    for name in ("amy", "ben"):
        start("edge_node", "--connect", endpoints[0], "--name", name).wait_for("READY")
    for name in ("amy", "ben"):
        flags = ("--connect", endpoints[0], "--name", name, "--out", str(tmp_path / name))
        flags = (*flags, "--controller", "lc", "--duration", "2", "--push", "none")
        robots.append((name, start("robot_node", *flags)))
    for name, robot in robots:
        assert robot.wait() == 0, robot.output
        report = json.loads((tmp_path / name / "telemetry.json").read_text())
        # An answer to the other robot would be refused under `session`.
        assert report["link"]["downlink"]["refused"] == {}
