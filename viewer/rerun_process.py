"""Run rerun's executable as a child process, which ends with this process in every case."""

from __future__ import annotations

import importlib.util
import os
import re
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from shared.errors import UserError
from shared.process.entry import end_with_parent

HOST = "127.0.0.1"
START_TIMEOUT = 30.0
_BINARIES = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")


class RerunProcess:
    """A rerun process, which listens on the loopback interface only."""

    def __init__(self, *arguments: str) -> None:
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (until `stop`)
        self._process = subprocess.Popen(
            [str(rerun_binary()), "--bind", HOST, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            env={**os.environ, "RUST_LOG": "error", "RERUN_APP_ONLY": "true"},
            preexec_fn=end_with_parent(),
        )

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def wait(self, ready: Callable[[float], bool], *, timeout: float = START_TIMEOUT) -> str | None:
        """Wait until `ready(start time)` is true; if that fails, return rerun's last error."""
        started = time.monotonic()
        while not ready(started):
            if not self.running or time.monotonic() - started > timeout:
                return self._last_error()
            time.sleep(0.02)
        return None

    def stop(self) -> None:
        """End the process. May be called again."""
        self._process.terminate()
        try:
            self._process.wait(timeout=0.5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._errors.close()

    def _last_error(self) -> str:
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").split("\n")
        errors = [line for line in lines if "panicked at" in line or "error" in line.lower()]
        reason = errors[-1] if errors else "no reason given"
        return re.sub(r".*\.rs:\d+: |^Error: |.*panicked at ", "", reason).strip(" .'")


def rerun_binary() -> Path:
    """Return rerun's executable. When the command `rerun` is ended, it leaves that one behind."""
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec is not None and spec.origin else Path()
    for name in _BINARIES:
        if (folder / name).is_file():
            return folder / name
    raise UserError(f"rerun: expected its executable in {folder}, got none; reinstall rerun-sdk")


def free_port(preferred: int = 0) -> int:
    """Return `preferred` if it is free on the loopback interface, otherwise any free port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, preferred))
        except OSError:
            probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
