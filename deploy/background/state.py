"""The files in a run's folder by which other processes see and control its stack.

RUN/stack/lock      Held until the process of the stack's supervisor ends.
RUN/stack/state     Services, their processes and how the run ended, as JSON.
RUN/stack/log       The lines that were printed.
RUN/stack/control   The socket that takes requests.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from io import RawIOBase
from pathlib import Path
from typing import Any, TextIO

from shared.commands import wbc
from shared.errors import ConfigError, writing
from shared.file_lock import is_locked, lock

STARTING, READY, STOPPING, ENDED = "starting", "ready", "stopping", "ended"
# Between a failure and the next start.
WAITING = "waiting"
# The state takes this room from the beginning, so that it can change on a full disk [bytes].
_STATE_BYTES = 16_384
_LOCK_SECONDS = 5.0
# A reader may meet a state that is half written.
_READ_ATTEMPTS, _READ_PAUSE_SECONDS = 20, 0.01


@dataclass(frozen=True)
class ServiceState:
    """The last process of a service: its state, since when [s since 1970], and its exit code.

    `degraded`: it has failed so often that it waits before each start. `degraded_seconds` is the
    time for which it has been so.
    """

    name: str
    pid: int
    state: str
    since: float
    restarts: int
    exit_code: int | None
    degraded: bool = False
    degraded_seconds: float = 0.0


def exit_in_words(code: int) -> str:
    """Return an exit code in words. A negative one means that a signal killed the process."""
    return f"exit {code}" if code >= 0 else f"signal {-code}"


@dataclass(frozen=True)
class StackState:
    """A stack: its supervisor's process, its services, and how it ended, if it has.

    `started` tells the process from a later one with the same number: see `deploy.process_stat`.
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
    started: int | None = None

    @property
    def degraded(self) -> tuple[str, ...]:
        """The names of the degraded services."""
        return tuple(service.name for service in self.services if service.degraded)


def _private_folder(folder: Path, *, what: str) -> None:
    """Make a folder that other users cannot enter.

    Raise `ConfigError`, which begins with `what`, if that is impossible.
    """
    with writing(folder, what=what):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if folder.stat().st_uid != os.geteuid():
            raise ConfigError(
                f"{what}: expected a folder of this user, got {folder} of another user; remove it, "
                "or use a copy of the project of your own"
            )
        folder.chmod(0o700)


def open_private(path: Path) -> TextIO:
    """Open a file for writing that other users cannot open, so that they cannot hold its lock."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    # The file may be older than this rule.
    os.fchmod(descriptor, 0o600)
    return os.fdopen(descriptor, "r+", encoding="utf-8")


def hold_private(path: Path, *, what: str, within: float, held_by: str) -> TextIO:
    """Make a private folder with a file in it, and hold the file's lock until it is closed.

    Raise `ConfigError`, which begins with `what`, if the file cannot be written, or with the text
    `held_by` if another process holds its lock for `within` [s].
    """
    _private_folder(path.parent, what=what)
    with writing(path, what=what):
        held = open_private(path)
    if not lock(held, within=within):
        held.close()
        raise ConfigError(f"{what}: {held_by}")
    return held


class LineFile:
    """Writes each line to a file at once. If the disk is full, lines are dropped.

    Other users cannot read a file that it makes: the viewer prints a secret address.
    """

    def __init__(self, path: Path) -> None:
        self._file: RawIOBase | None = None
        with contextlib.suppress(OSError):
            # Without a buffer: a buffer that cannot be written is tried again with every line.
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            self._file = os.fdopen(descriptor, "ab", buffering=0)

    def __enter__(self) -> LineFile:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._file is not None:
            self._file.close()

    def add(self, line: str) -> None:
        """Add a line."""
        if self._file is not None:
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

        Raise `ConfigError` if the folder cannot be written, or if another process holds the lock.
        """
        held_by = f"another stack uses {self.run}; try another --out"
        return hold_private(self._lock, what="out", within=_LOCK_SECONDS, held_by=held_by)

    @property
    def alive(self) -> bool:
        """Return whether the supervisor lives."""
        return is_locked(self._lock)

    def write(self, state: StackState) -> None:
        """Overwrite the state in place, which works on a full disk too.

        If it cannot be written, the old state stays and the run goes on.
        """
        text = json.dumps(dataclasses.asdict(state), indent=2)
        with contextlib.suppress(OSError), open_private(self._state) as file:
            size = max(os.fstat(file.fileno()).st_size, _STATE_BYTES)
            os.pwrite(file.fileno(), text.encode().ljust(size - 1) + b"\n", 0)

    def read(self) -> StackState:
        """Return the last state; raise `ConfigError` if this is not the folder of a run.

        Another user's state is refused: it could name any process.
        """
        for _ in range(_READ_ATTEMPTS):
            try:
                owner = self._state.stat().st_uid
                if owner != os.geteuid():
                    raise ConfigError(f"run: expected a run of this user, got {self.run}")
                return _state_from(json.loads(self._state.read_text(encoding="utf-8")))
            except ValueError:
                time.sleep(_READ_PAUSE_SECONDS)
            except (OSError, KeyError, TypeError, AttributeError):
                break
        raise ConfigError(
            f"run: expected the folder of a run that {wbc('up')} made, got {self.run}"
        )


def _state_from(table: dict[str, Any]) -> StackState:
    services = tuple(ServiceState(**each) for each in table.pop("services"))
    return StackState(**{**table, "named": tuple(table["named"]), "services": services})


@contextlib.contextmanager
def within(folder: Path) -> Iterator[None]:
    """Change into a folder for a moment, because a socket's path has at most 100 characters."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
