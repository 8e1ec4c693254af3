"""A command has one answer, and a flood of them takes nothing from the server's process."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shared.bus import operator
from shared.bus.operator import CommandClient, CommandServer
from shared.bus.zenoh_bus import ZenohBus
from shared.errors import ConfigError, LinkError
from shared.wire.operator.commands import Accepted, Command, Cut, Pause
from shared.wire.operator.messages import LINK_COMMANDS_KEY, ROBOT_COMMANDS_KEY, encode_command
from tests.processes import PATIENCE_SECONDS, until

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

    monkeypatch.setattr(operator, "_PAUSE_SECONDS", 0.0)
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


def test_another_user_cannot_reach_the_hub(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can act as another user")
    from deploy.console.status import Status
    from deploy.console.watch import open_hub
    from shared.telemetry.schema import tick_schema

    tmp_path.chmod(0o755)
    status = Status(tick_schema(nq=38, nv=37), duration=1.0)
    hub = open_hub(f"unixsock-stream/{tmp_path}/hub", status, "romeo")
    child = os.fork()
    if child == 0:
        import socket

        os.setuid(65534)
        try:
            socket.socket(socket.AF_UNIX).connect(f"{tmp_path}/hub")
        except PermissionError:
            os._exit(0)
        except BaseException:
            os._exit(2)
        os._exit(1)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    hub.close()
    assert code == 0
