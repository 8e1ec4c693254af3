"""Serve the page, its newest state and its commands, to browsers on this machine alone.

The address has a random token; a request without it gets nothing. Every browser holds a connection
on which it gets states and sends commands. When it has taken one state, it gets the newest. So a
slow browser skips states, and never shows an old one.
"""

from __future__ import annotations

import asyncio
import http
import json
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from shared.errors import UserError
from viewer.rerun_process import HOST

FILES = {
    "": ("index.html", "text/html; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
    "robot.js": ("robot.js", "text/javascript; charset=utf-8"),
}
ROBOT, STREAM = "robot.json", "stream"
# The line by which a browser says that it has taken a state.
TAKEN = "taken"
MAX_BROWSERS = 8
# A command is a line of text.
_MAX_COMMAND = 300
# A browser that reads nothing for this time is given up [s].
_PATIENCE = 20.0


class _Slot:
    """The place of a browser: whether there is a `new` state, and whether it has `taken` the last.

    It is compared by identity.
    """

    def __init__(self) -> None:
        self.new = asyncio.Event()
        self.taken = asyncio.Event()


class PageServer:
    """The page of one run.

    `robot` is the JSON that does not change: title and hulls. `state` is the first state.

    `command` carries out a line of text and returns an answer, empty if there is nothing to say. It
    raises `UserError` to refuse. It is called on a thread, one call at a time.
    """

    def __init__(self, robot: str, state: str, command: Callable[[str], str]) -> None:
        self._token = secrets.token_urlsafe(16)
        self._robot = robot
        self._command = command
        self._commanding = asyncio.Lock()
        self._state = state
        self._slots: set[_Slot] = set()
        self._server: Server | None = None
        self._port = 0

    @property
    def address(self) -> str:
        """The address for a browser; it gives access to the run."""
        return f"http://{HOST}:{self._port}/{self._token}/"

    @property
    def browsers(self) -> int:
        """The number of connected browsers."""
        return len(self._slots)

    async def open(self, port: int) -> None:
        """Begin to listen on a port of the loopback interface, 0 for any free one."""
        self._server = await serve(
            self._connected,
            HOST,
            port,
            process_request=self._answer,
            compression=None,
            max_size=_MAX_COMMAND,
            max_queue=2,
            ping_timeout=_PATIENCE,
            open_timeout=_PATIENCE,
            server_header=None,
        )
        self._port = int(self._server.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """End all connections."""
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def show(self, state: str) -> None:
        """Give a new state to all browsers; it replaces a state that was not sent yet."""
        self._state = state
        for slot in self._slots:
            slot.new.set()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a request; None begins the stream of states."""
        token, _, name = request.path.removeprefix("/").partition("/")
        host = f"{HOST}:{self._port}"
        # A page from elsewhere has another host or origin, even if its name leads to this machine.
        known = request.headers.get("Host") == host
        own = request.headers.get("Origin") in (None, f"http://{host}")
        if not (secrets.compare_digest(token.encode(), self._token.encode()) and known and own):
            return self._response(
                http.HTTPStatus.FORBIDDEN,
                b"expected the address with its token, as the viewer printed it; try that one\n",
                "text/plain; charset=utf-8",
            )
        if name == STREAM:
            if self.browsers < MAX_BROWSERS:
                return None
            status, text = http.HTTPStatus.SERVICE_UNAVAILABLE, b"too many browsers; close one\n"
            return self._response(status, text, "text/plain; charset=utf-8")
        if name == ROBOT:
            return self._response(http.HTTPStatus.OK, self._robot.encode(), "application/json")
        if name in FILES:
            file, kind = FILES[name]
            data = files(__package__).joinpath(file).read_bytes()
            return self._response(http.HTTPStatus.OK, data, kind)
        text = f"expected one of {', '.join(FILES)}, got {name}\n".encode()
        return self._response(http.HTTPStatus.NOT_FOUND, text, "text/plain; charset=utf-8")

    def _response(self, status: http.HTTPStatus, body: bytes, kind: str) -> Response:
        headers = Headers(
            {
                "Content-Type": kind,
                "Content-Length": str(len(body)),
                "Connection": "close",
                "Cache-Control": "no-store",
                # Nothing comes from elsewhere or goes there, and no other page shows this one.
                "Content-Security-Policy": (
                    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' "
                    f"ws://{HOST}:{self._port}; img-src data:; base-uri 'none'; "
                    "form-action 'none'; frame-ancestors 'none'"
                ),
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
            }
        )
        return Response(status.value, status.phrase, headers, body)

    async def _connected(self, connection: ServerConnection) -> None:
        with self._slot() as slot:
            sending = asyncio.create_task(self._send(connection, slot))
            try:
                async for line in connection:
                    if line == TAKEN:
                        slot.taken.set()
                        continue
                    answer, refused = await self._carry_out(line)
                    await connection.send(json.dumps({"answer": answer, "refused": refused}))
            except ConnectionClosed:
                pass
            finally:
                sending.cancel()

    @contextmanager
    def _slot(self) -> Iterator[_Slot]:
        slot = _Slot()
        slot.new.set()
        slot.taken.set()
        self._slots.add(slot)
        try:
            yield slot
        finally:
            self._slots.discard(slot)

    async def _send(self, connection: ServerConnection, slot: _Slot) -> None:
        """Send each new state. While the browser takes one, the next replaces those in between."""
        try:
            while True:
                await slot.taken.wait()
                await slot.new.wait()
                slot.taken.clear()
                slot.new.clear()
                await connection.send(self._state)
        except ConnectionClosed:
            pass

    async def _carry_out(self, line: str | bytes) -> tuple[str, bool]:
        """Carry a command out. Return the answer, and whether it is a refusal."""
        text = line if isinstance(line, str) else line.decode(errors="replace")
        async with self._commanding:
            try:
                return await asyncio.to_thread(self._command, text), False
            except UserError as error:
                return str(error), True
