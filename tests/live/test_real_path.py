"""Robot and edge on two machines, which are namespaces here, joined by a slow cable and no shim."""

from __future__ import annotations

import contextlib
import json
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.real_path.namespaces import Machines, two_machines
from deploy.keys import make
from shared.errors import UserError
from tests.processes import Process, descendants_naming

pytestmark = pytest.mark.live

Start = Callable[..., Process]

# LA's projectors would take 216 Mbit/s.
RATE = "50mbit"


@pytest.fixture
def machines() -> Iterator[Machines]:
    """To be asked for before `start`: removed after everything in them has ended."""
    with contextlib.ExitStack() as stack:
        try:
            joined = stack.enter_context(two_machines(rate=RATE))
        except UserError as error:
            pytest.skip(str(error))
        yield joined


# Over tcp: the test below.
@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_robot_stands_on_an_edge_behind_a_slow_cable(
    machines: Machines, start: Start, tmp_path: Path, protocol: str
) -> None:
    endpoint = f"{protocol}/{machines.edge.address}:7460"
    make(tmp_path / "keys", robots=["romeo"], hosts=[machines.edge.address])
    secure = ("--secure", str(tmp_path / "keys"))
    edge = start(
        *("deploy", "up", "--only", "edge", "--listen", endpoint, *secure),
        *("--out", str(tmp_path / "edge")),
        machine=machines.edge,
    )
    edge.wait_for("READY")
    assert "UNPROTECTED" not in edge.output
    robot = start(
        *("deploy", "up", "--only", "robot", "--edge", endpoint, *secure),
        *("--controller", "lc", "--duration", "2", "--out", str(tmp_path / "robot")),
        machine=machines.robot,
    )
    assert robot.wait() == 0, robot.output
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    summary = json.loads((tmp_path / "robot/summary.json").read_text())
    assert summary["fell"] is False
    assert summary["commands"]["corrected"] == 2000
    assert summary["link"]["downlink"]["received"] > 0
    assert summary["link"]["downlink"]["refused"] == {}
    at_edge = json.loads((tmp_path / "edge/edge.json").read_text())
    assert at_edge["link"]["uplink"]["received"] > 1000
    assert descendants_naming(str(tmp_path)) == []


def test_a_cable_too_slow_loses_projectors_instead_of_delaying_them(
    machines: Machines, start: Start, tmp_path: Path
) -> None:
    endpoint = f"tcp/{machines.edge.address}:7460"
    edge = start("edge_node", "--listen", endpoint, machine=machines.edge)
    edge.wait_for("READY")
    robot = start(
        *("robot_node", "--connect", endpoint, "--controller", "la", "--push", "none"),
        *("--duration", "2", "--out", str(tmp_path)),
        machine=machines.robot,
    )
    assert robot.wait() == 0, robot.output
    report = json.loads((tmp_path / "telemetry.json").read_text())
    assert report["link"]["downlink"]["lost"] > 0
    # Some 58 ms; with the kernel's own buffer 256, and the robot falls.
    assert report["projector_age_ms"]["p50"] < 120.0
