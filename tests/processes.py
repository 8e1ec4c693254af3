"""Processes that tests start, and waiting for what they do: for events, never for seconds.

Every wait has a bound, which is there so that a hang ends, and generous: no test passes or fails by
how fast the machine is.
"""

from __future__ import annotations

import functools
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

from benchmarks.real_path.namespaces import Machine
from shared.process.entry import python

ROOT = Path(__file__).resolve().parents[1]
# Nothing is given up sooner.
PATIENCE_SECONDS = 300.0
# A stack loads five processes one after the other, and the machine may do more besides by then.
_LOADS = 20
_Found = TypeVar("_Found")
# The fixture `typed` of tests/conftest.py.
Typed = Callable[..., subprocess.CompletedProcess[str]]


class Patience:
    """Whether it is time to give up waiting: never before PATIENCE_SECONDS, and on a slow machine
    not before a process could have been loaded some times.
    """

    def __init__(self) -> None:
        self._began = time.monotonic()

    @property
    def waited_seconds(self) -> float:
        return time.monotonic() - self._began

    @property
    def exhausted(self) -> bool:
        if self.waited_seconds < PATIENCE_SECONDS:
            return False
        load_seconds = _loading().seconds()
        return load_seconds is not None and self.waited_seconds > _LOADS * load_seconds


class _Loading:
    """How long it takes to load the robot, measured once: when somebody first has to know."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._seconds: float | None = None
        command = python("-m", "robot_node", "--help")
        self._process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)

    def seconds(self) -> float | None:
        """None while it is being measured."""
        if self._seconds is None and self._process.poll() is not None:
            self._seconds = time.monotonic() - self._began
        return self._seconds


@functools.cache
def _loading() -> _Loading:
    return _Loading()


def until(happened: Callable[[], _Found], message: Callable[[], str] | str) -> _Found:
    """What `happened()` returns as soon as that is true; else fails with what `message` tells."""
    patience = Patience()
    while not (found := happened()):
        if patience.exhausted:
            reason = message if isinstance(message, str) else message()
            raise AssertionError(f"in vain for {patience.waited_seconds:.0f} s: {reason}")
        time.sleep(0.01)
    return found


def ended(process: subprocess.Popen[str] | subprocess.Popen[bytes]) -> int:
    """Exit code of a process that is about to end."""
    until(lambda: process.poll() is not None, lambda: f"{process.args!r} does not end")
    return process.returncode


def played(
    *command: str, given: str = "", env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end: its exit code and what it has said."""
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, cwd=ROOT, env=env, stdin=pipe, stdout=pipe, stderr=pipe, text=True
    ) as process:
        try:
            shown = _communicated(process, given)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, *shown)


def _communicated(process: subprocess.Popen[str], given: str) -> tuple[str, str]:
    patience = Patience()
    left: str | None = given
    while True:
        try:
            return process.communicate(left, timeout=1.0)
        except subprocess.TimeoutExpired:
            left = None
            if patience.exhausted:
                raise


class Process:
    """`python -m …`, or `python -c …`, with its output collected line by line; on another `machine`
    if one is given. `end()` ends it, by its own pid.
    """

    def __init__(
        self, *arguments: str, machine: Machine | None = None, env: dict[str, str] | None = None
    ) -> None:
        command = python(*(() if arguments[0] == "-c" else ("-m",)), *arguments)
        self.popen = subprocess.Popen(
            command if machine is None else machine.command(*command),
            cwd=ROOT,
            env=env,
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

    def wait_for(self, text: str, *, times: int = 1) -> str:
        """The first line that contains `text`; or the second, the third …"""

        def shown() -> str | None:
            # Asked first: what it said before it ended is still read.
            over = not self._reader.is_alive()
            lines = [line for line in list(self.lines) if text in line]
            assert len(lines) >= times or not over, f"ended without {text!r}:\n{self.output}"
            return lines[times - 1] if len(lines) >= times else None

        line = until(shown, lambda: f"no line with {text!r}; output so far:\n{self.output}")
        assert line is not None
        return line

    def wait(self) -> int:
        """Exit code; all of its output is there."""
        until(
            lambda: self.popen.poll() is not None,
            lambda: f"it does not end; output so far:\n{self.output}",
        )
        self._reader.join(timeout=PATIENCE_SECONDS)
        return self.popen.returncode

    def signal(self, number: int) -> None:
        if self.popen.poll() is None:
            os.kill(self.popen.pid, number)

    def end(self) -> None:
        """Terminate, then kill, whatever is left of this process."""
        self.signal(signal.SIGTERM)
        try:
            self.popen.wait(timeout=PATIENCE_SECONDS)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            self.popen.wait(timeout=PATIENCE_SECONDS)
        self._reader.join(timeout=PATIENCE_SECONDS)
        assert self.popen.stdout is not None
        self.popen.stdout.close()


def refuses_another_user(address: Path, *, reachable: Path) -> bool:
    """Return whether a Unix socket refuses a user who can reach the folder `reachable`.

    Skip the test if this user is not root, who alone can act as another one.
    """
    if os.geteuid() != 0:
        pytest.skip("only root can act as another user")
    child = os.fork()
    if child == 0:
        code = 1
        os.setuid(65534)
        try:
            os.stat(reachable / ".")
            socket.socket(socket.AF_UNIX).connect(str(address))
        except PermissionError as error:
            # That of `stat` has a file name.
            code = 0 if error.filename is None else 2
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 1), f"another user cannot reach {reachable}"
    return code == 0


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
