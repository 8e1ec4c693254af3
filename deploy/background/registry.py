"""The stacks that were started in the background from this copy of the project.

Each is a link to its run's folder, `ROBOT.SERVICE+SERVICE`, and stays until the next one of the
same name takes its place. The links are in `runs/.stacks` of the project's folder, or, where it is
installed as a package, of all its installations in `remote-wbc/stacks` of the user's state folder
($XDG_STATE_HOME, ~/.local/state).
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from deploy.background.state import StackFolder, StackState
from shared.commands import CHECKOUT, wbc
from shared.errors import ConfigError


def registry_folder() -> Path:
    """Where the links are."""
    if CHECKOUT is not None:
        return CHECKOUT / "runs" / ".stacks"
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "remote-wbc" / "stacks"


class Registry:
    """The links, in `folder`."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or registry_folder()

    def check(self, run: Path | None, *, robot: str, services: tuple[str, ...]) -> None:
        """`ConfigError` if another stack than `run` has this robot and one of these services."""
        for stack, state in self.found(robot=robot):
            both = [name for name in services if name in state.named]
            if both and stack.alive and (run is None or stack.run != run.resolve()):
                raise ConfigError(
                    f"up: {', '.join(both)} of {robot} run already (pid {state.pid}, "
                    f"{stack.run}); {wbc('down')} ends them, --name starts another robot"
                )

    def add(self, run: Path, *, robot: str, services: tuple[str, ...]) -> None:
        """Enter a stack that holds the lock of its own folder already; checked as `check` does."""
        with self._locked():
            self.check(run, robot=robot, services=services)
            link = self._folder / f"{robot}.{'+'.join(services)}"
            new = link.with_name(f".{link.name}.{os.getpid()}")
            new.symlink_to(run.resolve(), target_is_directory=True)
            os.replace(new, link)

    def found(self, *, robot: str | None = None) -> list[tuple[StackFolder, StackState]]:
        """All stacks that are known, of one robot if it is given, the newest first."""
        stacks = []
        for link in sorted(self._folder.glob("[!.]*")):
            # Its folder may have been removed.
            with contextlib.suppress(ConfigError):
                stack = StackFolder(link.resolve())
                state = stack.read()
                if robot is None or state.robot == robot:
                    stacks.append((stack, state))
        return sorted(stacks, key=lambda each: each[1].since, reverse=True)

    def current(self, *, robot: str | None = None) -> list[tuple[StackFolder, StackState]]:
        """Those that run; if none does, the one that ended last."""
        known = self.found(robot=robot)
        return [each for each in known if each[0].alive] or known[:1]

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Two that start at once do so one after the other."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            lock = (self._folder / ".lock").open("w", encoding="ascii")
        except OSError as error:
            raise ConfigError(f"up: cannot write {self._folder}: {error.strerror}") from None
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
