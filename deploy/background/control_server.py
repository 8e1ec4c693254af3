"""Serve requests to a running stack over its control socket, which other users cannot reach.

A connection carries one request and one answer, each a line of JSON. A request is a table with one
key, its name: `{"restart": "edge"}`, `{"command": "link cut"}`. The answer to a request that is
refused is `{"error": …}`.
"""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from deploy.background.state import StackFolder, within
from shared.errors import UserError, one_of

# The requests by name. Each takes a text, and returns the answer.
Requests = Mapping[str, Callable[[str], Awaitable[dict[str, Any]]]]
# Requests that may wait for their answers. A flood of them should cost this process little.
_MAX_OPEN = 8


class ControlServer:
    """Serves requests while a stack runs."""

    def __init__(self, stack: StackFolder, requests: Requests) -> None:
        self._stack = stack
        self._requests = requests
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
        answer: dict[str, Any] = {"error": "the stack ended meanwhile"}
        try:
            answer = await self._answer(reader)
        finally:
            writer.write(json.dumps(answer).encode() + b"\n")
            writer.close()
            self._open.discard(task)

    async def _answer(self, reader: asyncio.StreamReader) -> dict[str, Any]:
        try:
            line = await reader.readline()
            if len(self._open) > _MAX_OPEN:
                return {"error": f"expected at most {_MAX_OPEN} requests at once; try again"}
            ((name, text),) = json.loads(line).items()
            if name not in self._requests:
                return {"error": f"request: {one_of(self._requests, name)}"}
            return await self._requests[name](str(text))
        except UserError as error:
            return {"error": str(error)}
        except (ValueError, AttributeError, RecursionError):
            return {"error": "not a request"}
