"""The files in a run's folder by which other processes see and control its stack.

RUN/stack/lock      Held until the process of the stack's supervisor ends.
RUN/stack/state     Services, their processes and how the run ended, as JSON.
RUN/stack/log       The lines that were printed.
RUN/stack/control   The socket that takes requests.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from shared.commands import wbc
from shared.errors import ConfigError

STARTING, READY, STOPPING, ENDED = "starting", "ready", "stopping", "ended"


@dataclass(frozen=True)
class ServiceState:
    """The last process of a service: its state, since when [s since 1970], and its exit code."""

    name: str
    pid: int
    state: str
    since: float
    restarts: int
    exit_code: int | None


def exit_in_words(code: int) -> str:
    """Return an exit code in words. A negative one means that a signal killed the process."""
    return f"exit {code}" if code >= 0 else f"signal {-code}"


@dataclass(frozen=True)
class StackState:
    """A stack: its supervisor's process, its services, and how it ended, if it has.

    `robot` is the name on the link, `named` every service of the plan, `services` the services that
    have been started. `state` and `since` are as in `ServiceState`.
    """

    pid: int
    robot: str
    named: tuple[str, ...]
    state: str
    since: float
    services: tuple[ServiceState, ...] = ()
    outcome: str = ""
    exit_code: int | None = None


class LineFile:
    """Writes each line to a file at once. If the disk is full, lines are dropped."""

    def __init__(self, path: Path) -> None:
        # Without a buffer: a buffer that cannot be written is tried again with every line.
        self._file = path.open("ab", buffering=0)

    def __enter__(self) -> LineFile:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def add(self, line: str) -> None:
        """Add a line."""
        with contextlib.suppress(OSError):
            self._file.write(f"{line}\n".encode())


class StackFolder:
    """The stack's files in the folder of a run."""

    def __init__(self, run: Path) -> None:
        self.run = run
        self.folder = run / "stack"
        self.log = self.folder / "log"
        self.control = self.folder / "control"
        self._state = self.folder / "state"
        self._lock = self.folder / "lock"

    def claim(self) -> TextIO:
        """Make the folder and hold its lock until the returned file is closed or this process ends.

        Raise `ConfigError` if the folder cannot be written.
        """
        try:
            self.folder.mkdir(exist_ok=True)
            held = self._lock.open("w", encoding="ascii")
        except OSError as error:
            raise ConfigError(f"out: cannot write {error.filename}: {error.strerror}") from None
        fcntl.flock(held, fcntl.LOCK_EX)
        return held

    @property
    def alive(self) -> bool:
        """Return whether the supervisor lives."""
        try:
            with self._lock.open(encoding="ascii") as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    def write(self, state: StackState) -> None:
        """Replace the state, so that a reader finds either the old one or the new one.

        If the disk is full, the old state stays and the run goes on.
        """
        new = self._state.with_suffix(".new")
        text = json.dumps(dataclasses.asdict(state), indent=2)
        with contextlib.suppress(OSError):
            new.write_text(text + "\n", encoding="utf-8")
            os.replace(new, self._state)

    def read(self) -> StackState:
        """Return the last state; raise `ConfigError` if this is not the folder of a run."""
        try:
            table = json.loads(self._state.read_text(encoding="utf-8"))
            services = tuple(ServiceState(**each) for each in table.pop("services"))
            return StackState(**{**table, "named": tuple(table["named"]), "services": services})
        except (OSError, ValueError, KeyError, TypeError):
            raise ConfigError(
                f"run: expected the folder of a run that {wbc('up')} made, got {self.run}"
            ) from None


@contextlib.contextmanager
def within(folder: Path) -> Iterator[None]:
    """Change into a folder for a moment, because a socket's path has at most 100 characters."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
