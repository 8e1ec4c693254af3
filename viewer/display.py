"""The sinks of a live recording: a file, and a window or a browser.

This process serves the recording, on the loopback interface only and with bounded memory. A child
process connects to that server and shows the recording: rerun's native viewer, or rerun's web
server for a browser. When this process ends, even by a crash, the child ends too.
"""

from __future__ import annotations

import socket
import time
import urllib.parse
from collections.abc import Callable
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from shared.errors import UserError
from viewer.rerun_process import HOST, RerunProcess, free_port

WEB_PORT = 9090
# The server keeps data for a view that is opened late, and drops the oldest first.
SERVER_MEMORY = "256MiB"
WINDOW_MEMORY = "1GiB"
VIEWS = ("native", "web", "page", "record")
# As the system's table of connections writes it.
_ESTABLISHED = "01"
# A window that cannot open gives up well within this time [s].
SETTLE = 1.0


class Display:
    """The sinks of one live recording, and the child process that shows it.

    `state` names the sinks in words. `address` is the page for a browser, or empty.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        view: str,
        *,
        blueprint: rrb.Blueprint,
        file: Path | None,
        newest_first: bool = False,
    ) -> None:
        """Open the sinks for `view` (of `VIEWS`, no page) and `file`; `UserError` if one fails.

        With `newest_first`, a view that is opened late shows the newest data at once.
        """
        if view == "record" and file is None:
            raise UserError("--view record: expected --out DIR for the recording, got none")
        self.state = f"recording to {file}"
        self.address = ""
        self._recording = recording
        self._child: RerunProcess | None = None
        self._port = 0
        sinks: list[rr.FileSink | rr.GrpcServerSink] = []
        if file is not None:
            sinks.append(rr.FileSink(_writable(file)))
        if view != "record":
            self._port = free_port()
            server = rr.GrpcServerSink(
                HOST, self._port, server_memory_limit=SERVER_MEMORY, newest_first=newest_first
            )
            sinks.append(server)
        recording.set_sinks(*sinks, default_blueprint=blueprint)
        if view == "native":
            self._open_window(server.uri)
        elif view == "web":
            self._open_web(server.uri)

    @property
    def shown(self) -> bool:
        """Return whether the window or the web server still runs."""
        return self._child is not None and self._child.running

    @property
    def seen(self) -> bool:
        """Return whether a window or a browser has connected."""
        return self.shown and _has_client(self._port)

    def close(self) -> None:
        """Stop the child, write the recording out and stop serving it."""
        if self._child is not None:
            self._child.stop()
        self._recording.disconnect()

    def _open_window(self, uri: str) -> None:
        port = str(free_port())
        arguments = ("--port", port, "--memory-limit", WINDOW_MEMORY, "--hide-welcome-screen", uri)
        self._open("the window", arguments, lambda started: time.monotonic() - started > SETTLE)
        self.state = "window opened"

    def _open_web(self, uri: str) -> None:
        port = free_port(WEB_PORT)
        arguments = ("--serve-web", "--web-viewer-port", str(port), uri)
        self._open("the web viewer", arguments, lambda started: _answers(port))
        self.state = "in a browser, at the address below"
        self.address = f"http://{HOST}:{port}/?url={urllib.parse.quote(uri, safe='')}"

    def _open(self, what: str, arguments: tuple[str, ...], ready: Callable[[float], bool]) -> None:
        """Start the child and wait until it shows the recording; `UserError` if it does not."""
        self._child = RerunProcess(*arguments)
        reason = self._child.wait(ready)
        if reason is not None:
            self.close()
            raise UserError(
                f"{what} could not be opened ({reason}); try another of --view {', '.join(VIEWS)}"
            )


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex((HOST, port)) == 0


def _has_client(port: int) -> bool:
    """Return whether a connection to a port of this machine stands, as far as the system says."""
    try:
        lines = Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
    except OSError:
        return True
    fields = [line.split() for line in lines]
    return any(each[1].endswith(f":{port:04X}") and each[3] == _ESTABLISHED for each in fields)


def _writable(file: Path) -> Path:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.open("wb").close()
    except OSError as error:
        raise UserError(f"--out: cannot write {file}: {error.strerror}") from None
    return file
