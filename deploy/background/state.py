"""What a stack says about itself in its run's folder, to those who come later or from elsewhere.

RUN/stack/lock      held while the stack's supervisor lives, however it ends
RUN/stack/state     services, their processes and how the run ended, as JSON
RUN/stack/log       what was said, as it was printed
RUN/stack/control   socket that takes requests
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
    """A service: its last process, what it does since when [s since 1970], and how it ended."""

    name: str
    pid: int
    state: str
    since: float
    restarts: int
    exit_code: int | None


def exit_in_words(code: int) -> str:
    """An exit code; a negative one is that of a process that a signal has killed."""
    return f"exit {code}" if code >= 0 else f"signal {-code}"


@dataclass(frozen=True)
class StackState:
    """A stack: its supervisor's process, its services, and once it has ended, how.

    `robot` is the name on the link, `named` every service of its plan, `services` those that have
    been started. `state` as of a service.
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
    """Lines added to a file, each at once. Those that a full disk has no room for are missing."""

    def __init__(self, path: Path) -> None:
        # Without a buffer: one that cannot be written would be tried again with every line.
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
        """Make the folder and hold its lock, until what is returned is closed or we end."""
        try:
            self.folder.mkdir(exist_ok=True)
            held = self._lock.open("w", encoding="ascii")
        except OSError as error:
            raise ConfigError(f"out: cannot write {error.filename}: {error.strerror}") from None
        fcntl.flock(held, fcntl.LOCK_EX)
        return held

    @property
    def alive(self) -> bool:
        """Whether the supervisor lives."""
        try:
            with self._lock.open(encoding="ascii") as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    def write(self, state: StackState) -> None:
        """Replace the state: whoever reads it finds the old one or the new one.

        A full disk leaves the old one: it stops no run.
        """
        new = self._state.with_suffix(".new")
        text = json.dumps(dataclasses.asdict(state), indent=2)
        with contextlib.suppress(OSError):
            new.write_text(text + "\n", encoding="utf-8")
            os.replace(new, self._state)

    def read(self) -> StackState:
        """The last state; `ConfigError` if this is no folder of a run."""
        try:
            table = json.loads(self._state.read_text(encoding="utf-8"))
            services = tuple(ServiceState(**each) for each in table.pop("services"))
            return StackState(**{**table, "named": tuple(table["named"]), "services": services})
        except (OSError, ValueError, KeyError, TypeError):
            raise ConfigError(
                f"run: expected the folder of a run of {wbc('up')}, {self.run} is none"
            ) from None


@contextlib.contextmanager
def within(folder: Path) -> Iterator[None]:
    """Be in a folder for a moment: the path of a socket has room for a hundred characters only."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
