"""Control a running stack over its socket.

A connection carries one request and one answer, each a line of JSON.
"""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable

from deploy.background.state import StackFolder, within
from shared.commands import wbc
from shared.errors import LinkError, UserError


class ControlServer:
    """Serves requests while a stack runs. `restart` is the only request."""

    def __init__(self, stack: StackFolder, restart: Callable[[str], Awaitable[None]]) -> None:
        self._stack = stack
        self._restart = restart
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> ControlServer:
        listening = socket.socket(socket.AF_UNIX)
        with within(self._stack.folder):
            listening.bind(self._stack.control.name)
        self._stack.control.chmod(0o600)
        self._server = await asyncio.start_unix_server(self._serve, sock=listening)
        return self

    async def __aexit__(self, *exception: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)
        self._stack.control.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._open.add(task)
        answer = {"error": "the stack ended meanwhile"}
        try:
            request = json.loads(await reader.readline())
            await self._restart(str(request["restart"]))
            answer = {}
        except UserError as error:
            answer = {"error": str(error)}
        except (ValueError, KeyError, TypeError):
            answer = {"error": "not a request"}
        finally:
            writer.write(json.dumps(answer).encode() + b"\n")
            writer.close()
            self._open.discard(task)


def request_restart(stack: StackFolder, service: str, *, within_seconds: float) -> None:
    """Ask a stack to start a service again; return when it is ready.

    Raise `LinkError` if it does not become ready.
    """
    asking = socket.socket(socket.AF_UNIX)
    asking.settimeout(within_seconds)
    try:
        with asking, within(stack.folder):
            asking.connect(stack.control.name)
            asking.sendall(json.dumps({"restart": service}).encode() + b"\n")
            with asking.makefile(encoding="utf-8") as answers:
                answer = json.loads(answers.readline())
    except (OSError, ValueError):
        raise LinkError(
            f"restart: {stack.run} does not answer; {wbc('ps')} says whether it runs"
        ) from None
    if "error" in answer:
        raise LinkError(answer["error"])
