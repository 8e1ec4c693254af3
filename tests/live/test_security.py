"""Mutual TLS and access control between real processes; the same attacks work without them."""

from __future__ import annotations

import dataclasses
import json
import signal
import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deploy.keys import make
from shared.bus.base import Delivery
from shared.bus.preflight import preflight
from shared.bus.security import Credentials
from shared.bus.zenoh_bus import ZenohBus
from shared.errors import LinkError
from shared.wire.channels import DOWNLINK, UPLINK
from tests.processes import PATIENCE_SECONDS, Process, until
from tests.telemetry_hub import TelemetryHub, is_heard

pytestmark = pytest.mark.live

Start = Callable[..., Process]

ROBOT = ("--controller", "lc", "--push", "none")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make(folder, robots=["romeo", "talos"])
    return folder


@pytest.fixture(scope="module")
def other_keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same roles, signed by another authority."""
    folder = tmp_path_factory.mktemp("other-keys")
    make(folder, robots=["romeo"])
    return folder


@pytest.fixture
def watched(hub: Callable[[], TelemetryHub]) -> TelemetryHub:
    return hub()


@pytest.fixture
def secured(endpoints: list[str]) -> list[str]:
    return [endpoint.replace("tcp/", "tls/") for endpoint in endpoints]


def disguised(kind: type[Credentials], keys: Path, role: str) -> Credentials:
    """The credentials of a role, as another kind."""
    return kind(**vars(Credentials.load(keys, role)))


class Lawless(Credentials):
    """Good certificates in the hands of somebody who restrains himself in nothing."""

    def settings(self) -> dict[str, Any]:
        own = super().settings()
        del own["access_control"]
        return own


class Rogue:
    """Forges states and projectors of romeo on its keys, and listens to everything."""

    def __init__(self, endpoint: str, credentials: Credentials | None) -> None:
        self.overheard: list[bytes] = []
        self._bus = ZenohBus.dial(endpoint, within=PATIENCE_SECONDS, credentials=credentials)
        self._sent: set[bytes] = set()
        self._bus.subscribe("**", self._listen)
        self._publishers = [
            self._bus.publisher(each.key_for("romeo"), wait_when_full=True)
            for each in (UPLINK, DOWNLINK)
        ]

    def _listen(self, delivery: Delivery) -> None:
        if delivery.data not in self._sent:
            self.overheard.append(delivery.data)

    def attack(self, happened: Callable[[], bool], message: Callable[[], str]) -> None:
        """Forge forty messages each way, and more until something has happened."""
        before = len(self._sent)

        def forged() -> bool:
            data = b"forged %d" % len(self._sent)
            self._sent.add(data)
            for publisher in self._publishers:
                publisher.forward(Delivery(data, envelope=None))
            return len(self._sent) >= before + 40 and happened()

        until(forged, message)

    @property
    def is_heard(self) -> bool:
        """Whether somebody else may take its states for the robot's."""
        return is_heard(self._publishers[0])

    def close(self) -> None:
        self._bus.close()


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What reached whom in a run with a rogue beside it."""

    overheard: int
    robot_refused: dict[str, int]
    edge_refused: dict[str, int]
    fell: bool


def run_with_rogue(
    start: Start,
    watched: TelemetryHub,
    folder: Path,
    endpoints: list[str],
    *,
    where: str,
    keys: Path | None,
) -> Outcome:
    """Robot and edge, joined by nothing, the shim or the router; the rogue dials as the robot.

    It attacks for a second of the robot's; without keys, also until both ends have noticed it.
    """
    secure = () if keys is None else ("--secure", str(keys))
    there, here = endpoints
    edge_ends = ("--connect", there) if where == "router" else ("--listen", there)
    if where == "router":
        start("deploy.router", "--listen", there, *secure).wait_for("READY")
    edge = start("edge_node", *edge_ends, *secure, "--out", str(folder / "edge"))
    edge.wait_for("READY")
    dialled = there
    if where == "netem":
        dialled = here
        start(
            *("netem", "replay", "constant:4ms", *secure),
            *("--listen", here, "--connect", there),
        ).wait_for("READY")
    robot = start(
        *("robot_node", "--connect", dialled, *secure, "--out", str(folder / "robot")),
        *("--duration", "3600", "--telemetry", watched.endpoint, *ROBOT),
    )
    robot.wait_for("the task begins")
    credentials = None if keys is None else disguised(Lawless, keys, "robot-talos")
    rogue = Rogue(dialled, credentials)

    def lasted(ticks: int) -> Callable[[], bool]:
        end = watched.last("tick") + ticks
        return lambda: robot.popen.poll() is not None or watched.last("tick") > end

    def noticed() -> bool:
        message = "refuses a robot's states (undecodable)" in edge.output
        return message and watched.last("refused") > 20 and len(rogue.overheard) > 100

    def message() -> str:
        return f"{len(rogue.overheard)} overheard\n{robot.output}\n{edge.output}"

    try:
        if keys is None:
            rogue.attack(noticed, message)
        rogue.attack(lasted(1000), message)
    finally:
        rogue.close()
    # What was on its way when it left arrives.
    until(lasted(300), message)
    robot.signal(signal.SIGINT)
    # It may have fallen.
    assert robot.wait() in (130, 3), robot.output
    edge.signal(signal.SIGTERM)
    assert edge.wait() == 0, edge.output
    report = json.loads((folder / "robot/telemetry.json").read_text())
    edge_report = json.loads((folder / "edge/edge.json").read_text())
    assert report["link"]["downlink"]["received"] > 0
    return Outcome(
        overheard=len(rogue.overheard),
        robot_refused=report["link"]["downlink"]["refused"],
        edge_refused=edge_report["link"]["uplink"]["refused"],
        fell=report["fell"],
    )


def test_the_whole_stack_stands_with_every_connection_secured(
    start: Start, keys: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    up = start(
        *("deploy", "up", "--secure", str(keys), "--network", "constant:4ms", "--view", "off"),
        *("--duration", "1.5", "--push", "none", "--out", str(out)),
    )
    assert up.wait() == 0, up.output
    assert "READY tls/127.0.0.1" in up.output
    summary = json.loads((out / "summary.json").read_text())
    for way in ("uplink", "downlink"):
        assert summary["link"][way]["received"] > 0
        assert summary["link"][way]["refused"] == {}


@pytest.mark.parametrize("where", ["edge", "netem", "router"])
def test_a_robot_with_another_name_gets_nothing_and_forges_nothing(
    start: Start, watched: TelemetryHub, keys: Path, secured: list[str], tmp_path: Path, where: str
) -> None:
    outcome = run_with_rogue(start, watched, tmp_path, secured, where=where, keys=keys)
    assert outcome == Outcome(overheard=0, robot_refused={}, edge_refused={}, fell=False)


def test_without_certificates_the_same_rogue_hears_and_forges(
    start: Start, watched: TelemetryHub, endpoints: list[str], tmp_path: Path
) -> None:
    outcome = run_with_rogue(start, watched, tmp_path, endpoints, where="router", keys=None)
    assert outcome.overheard > 100
    # Of more than forty each way.
    assert outcome.robot_refused["undecodable"] > 20
    assert outcome.edge_refused["undecodable"] > 20
    assert not outcome.fell


class Talkative(Credentials):
    """Lets everybody subscribe to everything, as Zenoh sends nothing to where nobody listens."""

    def settings(self) -> dict[str, Any]:
        own = super().settings()
        for rule in own["access_control"]["rules"]:
            if rule["messages"] == ["declare_subscriber"]:
                rule["key_exprs"] = ["**"]
        return own


def test_messages_themselves_are_stopped_even_where_subscriptions_are_not(
    keys: Path, secured: list[str]
) -> None:
    arrived: list[bytes] = []
    router = ZenohBus(
        listen=[secured[0]], mode="router", credentials=disguised(Talkative, keys, "router")
    )
    edge, robot = (
        ZenohBus.dial(
            secured[0], within=PATIENCE_SECONDS, credentials=disguised(Talkative, keys, role)
        )
        for role in ("edge", "robot-romeo")
    )
    edge.subscribe(UPLINK.key_for("romeo"), lambda delivery: arrived.append(delivery.data))
    projectors = edge.publisher(DOWNLINK.key_for("romeo"), wait_when_full=True)
    answers: list[bytes] = []
    robot.subscribe(DOWNLINK.key_for("romeo"), lambda delivery: answers.append(delivery.data))
    states = robot.publisher(UPLINK.key_for("romeo"), wait_when_full=True)
    rogue = Rogue(secured[0], disguised(Lawless, keys, "robot-talos"))
    try:
        rogue.attack(lambda: rogue.is_heard, lambda: "nobody listens to the rogue")
        rogue.attack(lambda: True, lambda: "")
        # What comes later, of those who may, comes through.
        until(lambda: is_heard(states) and is_heard(projectors), "robot and edge are not joined")

        # The router may know one end before the other: the first ones may get lost.
        def through() -> bool:
            projectors.publish(b"not for talos")
            states.publish(b"of romeo")
            return min(len(answers), len(arrived)) >= 20

        until(through, lambda: f"{answers} {arrived}")
    finally:
        for bus in (rogue, robot, edge, router):
            bus.close()
    assert set(answers) == {b"not for talos"}
    assert set(arrived) == {b"of romeo"}
    assert rogue.overheard == []


def test_a_peer_without_a_certificate_is_refused(
    start: Start, keys: Path, secured: list[str]
) -> None:
    start("edge_node", "--listen", secured[0], "--secure", str(keys)).wait_for("READY")

    class Bare(Credentials):
        """Knows the authority, and has no certificate of its own."""

        def client_context(self) -> ssl.SSLContext:
            return ssl.create_default_context(cafile=str(keys / "ca.crt"))

        def settings(self) -> dict[str, Any]:
            own = super().settings()
            for name in ("connect_certificate", "connect_private_key"):
                del own[f"transport/link/tls/{name}"]
            own["transport/link/tls/enable_mtls"] = False
            return own

    bare = disguised(Bare, keys, "robot-romeo")

    def refused() -> str:
        # On a busy machine the refusal may come when it is no longer waited for.
        try:
            preflight(secured[0], bare)
        except LinkError as error:
            return str(error)
        return ""

    assert "refuses the certificate" in until(refused, "the edge accepts it")
    with pytest.raises(LinkError, match="cannot open"):
        ZenohBus(
            connect=[secured[0]],
            mode="client",
            credentials=bare,
            settings={"connect/timeout_ms": 2000, "connect/exit_on_failure": True},
        )


def test_a_robot_of_another_authority_is_told_so_at_once(
    start: Start, keys: Path, other_keys: Path, secured: list[str]
) -> None:
    start("edge_node", "--listen", secured[0], "--secure", str(keys)).wait_for("READY")
    robot = start("robot_node", "--connect", secured[0], "--secure", str(other_keys))
    assert robot.wait() == 2
    assert len(robot.lines) == 1, robot.output
    assert "its certificate is not accepted here" in robot.output
    assert "the ca.crt that signed" in robot.output


def test_an_edge_that_trusts_another_authority_refuses_the_robot(
    start: Start, keys: Path, other_keys: Path, secured: list[str], tmp_path: Path
) -> None:
    """The robot trusts both authorities; the edge only its own."""
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for role in ("robot-romeo.crt", "robot-romeo.key"):
        (mixed / role).write_bytes((other_keys / role).read_bytes())
    # The first one is that which the robot's own certificate is checked against.
    both = (other_keys / "ca.crt").read_text() + (keys / "ca.crt").read_text()
    (mixed / "ca.crt").write_text(both)
    start("edge_node", "--listen", secured[0], "--secure", str(keys)).wait_for("READY")
    robot = start("robot_node", "--connect", secured[0], "--secure", str(mixed))
    assert robot.wait() == 2
    assert len(robot.lines) == 1, robot.output
    assert "refuses the certificate of robot-romeo" in robot.output


def test_an_address_that_the_edges_certificate_does_not_have_is_named(
    start: Start, keys: Path, secured: list[str]
) -> None:
    # All of 127.0.0.0/8 is this machine; the certificate has 127.0.0.1 only.
    elsewhere = secured[0].replace("127.0.0.1", "127.0.0.2")
    start("edge_node", "--listen", elsewhere, "--secure", str(keys)).wait_for("READY")
    robot = start("robot_node", "--connect", elsewhere, "--secure", str(keys))
    assert robot.wait() == 2
    assert len(robot.lines) == 1, robot.output
    assert "--host 127.0.0.2" in robot.output


def test_certificates_against_a_plain_edge_say_what_is_there(
    start: Start, keys: Path, endpoints: list[str], secured: list[str], tmp_path: Path
) -> None:
    config = tmp_path / "impatient.toml"
    config.write_text("[loop]\nconnect_timeout = 1.0\n")
    start("edge_node", "--listen", endpoints[0]).wait_for("READY")
    robot = start(
        *("robot_node", "--connect", secured[0], "--secure", str(keys), "--config", str(config))
    )
    assert robot.wait() == 2
    assert len(robot.lines) == 1, robot.output
    assert "is it a plain endpoint" in robot.output
