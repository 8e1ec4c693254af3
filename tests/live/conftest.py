"""Real processes on loopback, each with a deadline and ended by its own pid."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deploy.namespaces import Machine

ROOT = Path(__file__).resolve().parents[2]


class Process:
    """A process with its output collected line by line; on another `machine` if one is given."""

    def __init__(self, *arguments: str, machine: Machine | None = None) -> None:
        command = [sys.executable, "-m", *arguments]
        self.popen = subprocess.Popen(
            command if machine is None else machine.command(*command),
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self.lines.append(line.rstrip("\n"))

    @property
    def output(self) -> str:
        return "\n".join(self.lines)

    def wait_for(self, text: str, *, seconds: float = 30.0) -> str:
        """The first line that contains `text`."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for line in list(self.lines):
                if text in line:
                    return line
            if self.popen.poll() is not None:
                self._reader.join(timeout=2.0)
                if text not in self.output:
                    break
            time.sleep(0.02)
        raise AssertionError(f"no line with {text!r}; output so far:\n{self.output}")

    def wait(self, *, seconds: float = 60.0) -> int:
        """Exit code."""
        code = self.popen.wait(timeout=seconds)
        self._reader.join(timeout=2.0)
        return code

    def signal(self, number: int) -> None:
        if self.popen.poll() is None:
            os.kill(self.popen.pid, number)

    def end(self) -> None:
        """Terminate, then kill, whatever is left of this process and its group."""
        self.signal(signal.SIGTERM)
        try:
            self.popen.wait(timeout=15.0)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            self.popen.wait(timeout=5.0)
        self._reader.join(timeout=5.0)
        assert self.popen.stdout is not None
        self.popen.stdout.close()


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Starts `python -m …`; everything started is ended with the test."""
    started: list[Process] = []

    def launch(*arguments: str, machine: Machine | None = None) -> Process:
        started.append(Process(*arguments, machine=machine))
        return started[-1]

    yield launch
    for process in reversed(started):
        process.end()


@pytest.fixture
def endpoints() -> list[str]:
    """Two free loopback endpoints."""
    sockets = [socket.socket() for _ in range(2)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    free = [f"tcp/127.0.0.1:{each.getsockname()[1]}" for each in sockets]
    for each in sockets:
        each.close()
    return free


def descendants_naming(text: str) -> list[int]:
    """Pids of processes whose command line contains `text`."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if text in command:
            found.append(int(path.parent.name))
    return found
