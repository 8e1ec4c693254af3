"""Two edges for one robot, and one edge for two robots: real processes on loopback."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.link_paths import free_endpoints
from tests.processes import Process, until
from tests.telemetry_hub import TelemetryHub

pytestmark = pytest.mark.live

Start = Callable[..., Process]


@pytest.mark.parametrize("controller", ["la", "lc"])
def test_a_robot_with_two_edges_does_not_notice_that_one_is_killed(
    start: Start, hub: Callable[[], TelemetryHub], tmp_path: Path, controller: str
) -> None:
    (meeting,) = free_endpoints(1)
    router = start("deploy.router", "--listen", meeting)
    router.wait_for("READY")
    edges = [start("edge_node", "--connect", meeting) for _ in range(2)]
    names = []
    for edge in edges:
        edge.wait_for("READY")
        ready = next(line for line in edge.lines if line.startswith("READY"))
        names.append(ready.split("romeo as ")[1].split()[0])
    watched = hub()
    robot = start(
        *("robot_node", "--connect", meeting, "--controller", controller),
        *("--telemetry", watched.endpoint),
        *("--duration", "3600", "--push", "none", "--out", str(tmp_path)),
    )
    robot.wait_for("answers come from 2 edges")
    until(lambda: watched.last("tick") > 500, lambda: robot.output)
    edges[0].signal(signal.SIGKILL)
    killed = watched.last("tick")
    until(lambda: watched.last("tick") > killed + 1500, lambda: robot.output)
    robot.signal(signal.SIGINT)
    assert robot.wait() == 130, robot.output
    downlink = json.loads((tmp_path / "telemetry.json").read_text())["link"]["downlink"]
    assert set(downlink["answers"]) == set(names)
    assert all(counts["taken"] > 0 for counts in downlink["answers"].values())
    assert downlink["refused"].keys() <= {"stale"}
    # Nothing was held, and with LC no answer was missed for longer than a sign of life takes.
    assert "holding the joints" not in robot.output


def test_one_edge_serves_robots_of_several_names(start: Start, tmp_path: Path) -> None:
    (meeting,) = free_endpoints(1)
    edge = start("edge_node", "--listen", meeting, "--name", "amy,ben", "--out", str(tmp_path))
    edge.wait_for("READY")
    robots = [
        start(
            *("robot_node", "--connect", meeting, "--name", name, "--controller", "lc"),
            *("--duration", "1", "--push", "none", "--out", str(tmp_path / name)),
        )
        for name in ("amy", "ben")
    ]
    for robot, name in zip(robots, ("amy", "ben"), strict=True):
        assert robot.wait() == 0, robot.output
        downlink = json.loads((tmp_path / name / "telemetry.json").read_text())["link"]["downlink"]
        # The answers to the other robot never come.
        assert downlink["refused"] == {}
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    for name in ("amy", "ben"):
        assert f"{name}: a robot is sending states" in edge.output


def test_two_robots_of_one_name_are_both_served_and_the_edge_says_so(
    start: Start, tmp_path: Path
) -> None:
    (meeting,) = free_endpoints(1)
    edge = start("edge_node", "--listen", meeting)
    edge.wait_for("READY")
    robots = [
        start(
            *("robot_node", "--connect", meeting, "--controller", "lc", "--push", "none"),
            *("--duration", "600", "--out", str(tmp_path / name)),
        )
        for name in ("first", "second")
    ]
    edge.wait_for("two robots send states under this name")
    for robot in robots:
        robot.wait_for("first answer received")
        robot.signal(signal.SIGTERM)
    for robot, name in zip(robots, ("first", "second"), strict=True):
        robot.wait()
        downlink = json.loads((tmp_path / name / "telemetry.json").read_text())["link"]["downlink"]
        # It hears the other's answers, because both are on one key.
        assert downlink["refused"].keys() <= {"session", "stale"}


def test_several_names_are_for_an_edge_alone(start: Start) -> None:
    run = start("deploy", "up", "--name", "amy,ben", "--duration", "1")
    assert run.wait() == 2
    assert run.lines[-1].startswith("error: name: expected one name")
