"""Requests to a stack over its control socket: one answer each, and from this user alone."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from deploy.background import control_server
from deploy.background.control_client import StackClient, request_restart
from deploy.background.control_server import ControlServer
from deploy.background.state import StackFolder
from shared.errors import ConfigError, LinkError
from shared.process.entry import python
from shared.wire.operator.commands import Accepted, Cut, Restore
from tests.processes import played, refuses_another_user

# Modules that take long to load, and that no command to a running stack needs.
HEAVY = (
    *("numpy", "zenoh", "pinocchio", "msgpack", "asyncio", "ssl"),
    *("shared.config.settings", "shared.config.extensions"),
)


@pytest.fixture
def stack(tmp_path: Path) -> StackFolder:
    made = StackFolder(tmp_path)
    made.claim().close()
    return made


@asynccontextmanager
async def served(stack: StackFolder, command: Callable[[str], Any]) -> AsyncIterator[None]:
    async def restart(service: str) -> dict[str, Any]:
        raise ConfigError(f"restart: {service} is starting already")

    async def carry_out(text: str) -> dict[str, Any]:
        answer: dict[str, Any] = await command(text)
        return answer

    async with ControlServer(stack, {"restart": restart, "command": carry_out}):
        yield


def test_a_command_has_one_answer_over_the_control_socket(stack: StackFolder) -> None:
    texts = []

    async def command(text: str) -> dict[str, Any]:
        texts.append(text)
        if text != "link cut":
            raise LinkError(f"{text}: not now")
        return {"time_ns": 7_000_000, "note": "a note"}

    async def play() -> None:
        client = StackClient(stack)
        async with served(stack, command):
            accepted = await asyncio.to_thread(client.send, Cut())
            assert accepted == Accepted(7_000_000, "a note")
            with pytest.raises(LinkError, match=r"^link restore: not now$"):
                await asyncio.to_thread(client.send, Restore())
            with pytest.raises(LinkError, match="edge is starting already"):
                await asyncio.to_thread(request_restart, stack, "edge", within_seconds=30.0)
        with pytest.raises(LinkError, match="does not answer"):
            client.send(Cut())

    asyncio.run(play())
    assert texts == ["link cut", "link restore"]


def told(stack: StackFolder, line: bytes) -> bytes:
    """The answer to a line that no client of ours sends."""
    with socket.socket(socket.AF_UNIX) as asking:
        asking.connect(str(stack.control))
        asking.sendall(line + b"\n")
        with asking.makefile("rb") as answers:
            return answers.readline()


def test_a_line_that_is_no_request_is_refused_and_ends_nothing(stack: StackFolder) -> None:
    async def command(text: str) -> dict[str, Any]:
        return {"time_ns": 0, "note": ""}

    async def play() -> None:
        async with served(stack, command):
            for line in (b"", b"[]", b"{}", b'{"a": 1, "b": 2}', b"\xff", b"x" * 100_000):
                answer = await asyncio.to_thread(told, stack, line)
                assert b'"error": "not a request"' in answer
            assert b"did you mean restart?" in await asyncio.to_thread(
                told, stack, b'{"restrat": ""}'
            )
            assert (await asyncio.to_thread(StackClient(stack).send, Cut())).time_ns == 0

    asyncio.run(play())


def test_of_a_flood_of_requests_few_wait_and_the_others_are_refused(
    stack: StackFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_server, "_MAX_OPEN", 2)
    begun, over = [], asyncio.Event()

    async def command(text: str) -> dict[str, Any]:
        begun.append(text)
        await over.wait()
        return {"time_ns": 0, "note": ""}

    async def play() -> None:
        async with served(stack, command):
            line = b'{"command": "link cut"}'
            waiting = [asyncio.create_task(asyncio.to_thread(told, stack, line)) for _ in range(2)]
            while len(begun) < 2:
                await asyncio.sleep(0)
            refused = await asyncio.to_thread(told, stack, line)
            assert b"expected at most 2 requests at once; try again" in refused
            over.set()
            answers = await asyncio.gather(*waiting)
        assert answers == [b'{"time_ns": 0, "note": ""}\n'] * 2
        assert len(begun) == 2

    asyncio.run(play())


def test_another_user_cannot_reach_the_control_socket(open_folder: Path) -> None:
    stack = StackFolder(open_folder / "run")
    (open_folder / "run").mkdir(mode=0o755)
    stack.claim().close()

    async def command(text: str) -> dict[str, Any]:
        return {"time_ns": 0, "note": ""}

    async def play() -> None:
        async with served(stack, command):
            assert refuses_another_user(stack.control, reachable=open_folder)

    asyncio.run(play())


@pytest.mark.parametrize("command", ["push 120N +y", "link cut", "go 1 0 90deg", "pause"])
def test_a_command_loads_nothing_that_takes_long(command: str, tmp_path: Path) -> None:
    script = (
        "import sys, remote_wbc\n"
        f"sys.argv = ['wbc', *{command.split()}, '--run', {str(tmp_path)!r}]\n"
        "try:\n    remote_wbc.main()\n"
        f"except SystemExit:\n    print([each for each in {HEAVY} if each in sys.modules])\n"
    )
    ended = played(*python("-c", script))
    assert f"no stack in {tmp_path} runs" in ended.stderr
    assert ended.stdout.strip() == "[]"


def test_a_command_hurries_and_a_study_of_the_same_name_does_not(tmp_path: Path) -> None:
    script = "import os, sys; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    if played(*python("-c", script)).returncode:
        pytest.skip("this user may not have real-time priority")
    for typed, policy in (
        (["link", "cut", "--run", str(tmp_path)], os.SCHED_FIFO),
        (["link", "--help"], os.SCHED_OTHER),
        (["ps", "--help"], os.SCHED_OTHER),
    ):
        script = (
            "import os, sys, remote_wbc\n"
            f"sys.argv = ['wbc', *{typed}]\n"
            "try:\n    remote_wbc.main()\n"
            "except SystemExit:\n"
            "    print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, file=sys.stderr)\n"
        )
        assert played(*python("-c", script)).stderr.splitlines()[-1] == str(policy), typed
