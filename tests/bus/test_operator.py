"""A command has one answer, and a flood of them takes nothing from the server's process."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shared.bus import operator
from shared.bus.memory import MemoryBus
from shared.bus.operator import CommandClient, CommandServer, RobotTimes
from shared.bus.zenoh_bus import ZenohBus
from shared.clock import SimClock
from shared.errors import ConfigError, LinkError
from shared.wire.operator.commands import Accepted, Command, Cut, Pause
from shared.wire.operator.events import parse_event
from shared.wire.operator.messages import (
    CLOCK_KEY,
    LINK_COMMANDS_KEY,
    ROBOT_COMMANDS_KEY,
    encode_command,
)
from shared.wire.robot_clock import ClockReading, encode_clock
from tests.processes import PATIENCE_SECONDS, refuses_another_user, until

pytestmark = pytest.mark.live

Dial = Callable[[], ZenohBus]


@pytest.fixture
def dial(tmp_path: Path) -> Iterator[Dial]:
    """Opens sessions with a hub."""
    endpoint = f"unixsock-stream/{tmp_path}/hub"
    buses = [ZenohBus(listen=[endpoint], mode="router")]

    def another() -> ZenohBus:
        buses.append(ZenohBus(connect=[endpoint], mode="client"))
        return buses[-1]

    yield another
    for bus in reversed(buses):
        bus.close()


def test_a_command_is_carried_out_once_and_answered(dial: Dial) -> None:
    done: list[Command] = []

    def carry_out(command: Command) -> Accepted:
        done.append(command)
        if len(done) == 2:
            raise ConfigError("pause: not now")
        if len(done) == 3:
            raise ZeroDivisionError
        return Accepted(7_000_000, "a note")

    CommandServer(dial(), ROBOT_COMMANDS_KEY, carry_out)
    client = CommandClient(dial())

    def answered() -> Accepted | None:
        # Until the hub knows the server, there is no answer.
        with contextlib.suppress(LinkError):
            return client.send(Pause())
        return None

    assert until(answered, "the server is not known") == Accepted(7_000_000, "a note")
    with pytest.raises(LinkError, match="pause: not now"):
        client.send(Pause())
    # An error of the program's own ends neither the server nor its thread.
    with pytest.raises(LinkError, match="an unexpected error: ZeroDivisionError"):
        client.send(Pause())
    assert client.send(Pause()).time_ns == 7_000_000
    assert len(done) == 4
    with pytest.raises(LinkError, match=r"link cut: .* the stack has no shim"):
        client.send(Cut())


def test_of_a_flood_the_server_sees_few(dial: Dial, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Command] = []
    over = threading.Event()

    def carry_out(command: Command) -> Accepted:
        seen.append(command)
        over.wait(PATIENCE_SECONDS)
        return Accepted(0)

    monkeypatch.setattr(operator, "_A_SECOND", 1e9)
    CommandServer(dial(), LINK_COMMANDS_KEY, carry_out)
    bus = dial()
    ends: list[object] = []

    def ask() -> None:
        bus._session.get(LINK_COMMANDS_KEY, ends.append, payload=encode_command(Cut()))

    def begun() -> bool:
        ask()
        return bool(seen)

    until(begun, "the hub does not know the server")
    for _ in range(200):
        ask()
    # The server has one in hand, and its queue holds four. The last of the flood are the newest.
    bus._session.get(LINK_COMMANDS_KEY, ends.append, payload=encode_command(Pause()))
    assert len(seen) == 1
    over.set()
    until(lambda: Pause() in seen, "the last command is not carried out")
    assert len(seen) <= 6


def test_a_script_follows_the_robots_clock_and_is_not_played_twice() -> None:
    hub = MemoryBus(SimClock())
    done: list[tuple[str, int]] = []

    def carry_out(command: Command) -> Accepted:
        accepted = times.carried_out(command, tell=False)
        done.append((str(command), accepted.time_ns))
        return accepted

    def tell(task_ns: int) -> None:
        """The robot's clock stands at a time of the task."""
        clock.publish(encode_clock(ClockReading(0, 5_000, 0.0, 5_000, task_ns)))

    times, clock = RobotTimes(hub, print), hub.publisher(CLOCK_KEY)
    texts = ("1s link cut", "3s link restore", "3.5s link cut", "9s link restore")
    times.play([parse_event(text) for text in texts], carry_out)
    # This process was started again at 3.4 s of the task.
    tell(3_400_000_000)
    until(lambda: len(done) == 1, "the last second's command does not come")
    tell(3_500_000_000)
    until(lambda: len(done) == 2, "a command does not come at its time")
    assert done == [("link restore", 3_400_000_000), ("link cut", 3_500_000_000)]
    # The robot's clock stands still, and so do the times of this process's rows.
    assert times.clock.at(10**18) == 5_000
    tell(9_000_000_000)
    until(lambda: len(done) == 3, "the last command does not come")


def test_another_user_cannot_reach_the_hub(open_folder: Path) -> None:
    from deploy.console.status import Status
    from deploy.console.watch import open_hub
    from shared.telemetry.schema import tick_schema

    status = Status(tick_schema(nq=38, nv=37), duration=1.0)
    hub = open_hub(f"unixsock-stream/{open_folder}/hub", status, "romeo")
    try:
        assert refuses_another_user(open_folder / "hub", reachable=open_folder)
    finally:
        hub.close()
