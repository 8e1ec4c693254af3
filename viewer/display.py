"""Where a live recording goes: a file, and a window or a browser.

The recording is served from this process, on the loopback interface only and with bounded memory.
What shows it is a child process that connects to that server: rerun's native viewer, or rerun's web
server for a browser. The child dies with this process, however this process ends.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
from collections.abc import Callable
from pathlib import Path
from typing import IO

import rerun as rr
import rerun.blueprint as rrb

from shared.errors import UserError

HOST = "127.0.0.1"
WEB_PORT = 9090
# For those who open the view late; the oldest data go first.
SERVER_MEMORY = "256MiB"
WINDOW_MEMORY = "1GiB"
VIEWS = ("native", "web", "record")
# A window that cannot open gives up well within this time [s].
SETTLE = 1.0
START_TIMEOUT = 10.0
_BINARIES = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
_PR_SET_PDEATHSIG = 1


class Display:
    """The sinks of one live recording, and the child process that shows it."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        view: str,
        *,
        blueprint: rrb.Blueprint,
        file: Path | None,
    ) -> None:
        """Open what `view` (one of `VIEWS`) and `file` ask for; `UserError` if that fails."""
        if view == "record" and file is None:
            raise UserError("--view record: expected --out DIR, where the recording goes")
        self.address = f"recording to {file}"
        self._recording = recording
        self._child: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (until `close`)
        sinks: list[rr.FileSink | rr.GrpcServerSink] = []
        if file is not None:
            sinks.append(rr.FileSink(_writable(file)))
        if view != "record":
            server = rr.GrpcServerSink(HOST, free_port(), server_memory_limit=SERVER_MEMORY)
            sinks.append(server)
        recording.set_sinks(*sinks, default_blueprint=blueprint)
        if view == "native":
            self._open_window(server.uri)
        elif view == "web":
            self._open_web(server.uri)

    @property
    def shown(self) -> bool:
        """Whether the window or the web server is still there."""
        return self._child is not None and self._child.poll() is None

    def close(self) -> None:
        """Stop the child, write the recording out and stop serving it."""
        self._stop_child()
        self._recording.disconnect()
        self._errors.close()

    def _open_window(self, uri: str) -> None:
        port = str(free_port())
        self._start("--port", port, "--memory-limit", WINDOW_MEMORY, "--hide-welcome-screen", uri)
        self._wait("the window", lambda started: time.monotonic() - started > SETTLE)
        self.address = "window opened"

    def _open_web(self, uri: str) -> None:
        port = free_port(WEB_PORT)
        self._start("--serve-web", "--web-viewer-port", str(port), uri)
        self._wait("the web viewer", lambda started: _answers(port))
        self.address = f"open http://{HOST}:{port}/?url={urllib.parse.quote(uri, safe='')}"

    def _start(self, *arguments: str) -> None:
        self._child = subprocess.Popen(
            [str(rerun_binary()), "--bind", HOST, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            env={**os.environ, "RUST_LOG": "error", "RERUN_APP_ONLY": "true"},
            preexec_fn=_die_with_parent() if sys.platform == "linux" else None,
        )

    def _wait(self, what: str, ready: Callable[[float], bool]) -> None:
        """Until `ready`, called with the time it began; `UserError` if the child ends first."""
        started = time.monotonic()
        while not ready(started):
            ended = self._child is None or self._child.poll() is not None
            if ended or time.monotonic() - started > START_TIMEOUT:
                reason = self._last_error()
                self.close()
                raise UserError(
                    f"{what} could not be opened ({reason}); try another of --view "
                    f"{', '.join(VIEWS)}"
                )
            time.sleep(0.02)

    def _last_error(self) -> str:
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").split("\n")
        told = [line for line in lines if "error" in line.lower()] or ["no reason given"]
        return re.sub(r".*\.rs:\d+: |^Error: ", "", told[-1]).strip(" .")

    def _stop_child(self) -> None:
        if self._child is None:
            return
        self._child.terminate()
        try:
            self._child.wait(timeout=0.5)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


def rerun_binary() -> Path:
    """rerun's own executable; its `rerun` command is a wrapper that would leave it behind."""
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec is not None and spec.origin else Path()
    for name in _BINARIES:
        if (folder / name).is_file():
            return folder / name
    raise UserError(f"rerun: expected its executable in {folder}; reinstall rerun-sdk")


def free_port(preferred: int = 0) -> int:
    """`preferred` if it is free on the loopback interface, else any port that is."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, preferred))
        except OSError:
            probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex((HOST, port)) == 0


def _writable(file: Path) -> Path:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.open("wb").close()
    except OSError as error:
        raise UserError(f"--out: cannot write {file}: {error.strerror}") from None
    return file


def _die_with_parent() -> Callable[[], None]:
    # Loaded before the fork: the child may only make the system call.
    libc = ctypes.CDLL(None)
    return lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM) and None
