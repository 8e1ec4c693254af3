"""The stacks that were started in the background from this copy of the project.

Each stack has a link to its run's folder. The link's name is `ROBOT.SERVICE+SERVICE`, and the next
stack of the same name replaces it. The links are in `runs/.stacks` of the project's folder. All
installations as a package share `remote-wbc/stacks` in the user's state folder ($XDG_STATE_HOME,
~/.local/state).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from deploy.background.state import StackFolder, StackState, hold_private
from shared.commands import CHECKOUT, wbc
from shared.errors import ConfigError, writing

_LOCK_SECONDS = 10.0


def registry_folder() -> Path:
    """Return the folder of the links."""
    if CHECKOUT is not None:
        return CHECKOUT / "runs" / ".stacks"
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "remote-wbc" / "stacks"


class Registry:
    """The links in one folder."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or registry_folder()

    def check(self, run: Path | None, *, robot: str, services: tuple[str, ...]) -> None:
        """Raise `ConfigError` if a stack other than `run` runs a service of this robot."""
        for stack, state in self.found(robot=robot):
            both = [name for name in services if name in state.named]
            if both and stack.alive and (run is None or stack.run != run.resolve()):
                raise ConfigError(
                    f"up: {', '.join(both)} of {robot} run already (pid {state.pid}, "
                    f"{stack.run}); {wbc('down')} ends them, --name starts another robot"
                )

    def add(self, run: Path, *, robot: str, services: tuple[str, ...]) -> None:
        """Add a stack, after a `check`. The stack already holds the lock of its folder."""
        with self._locked(), writing(self._folder, what="up"):
            self.check(run, robot=robot, services=services)
            link = self._folder / f"{robot}.{'+'.join(services)}"
            new = link.with_name(f".{link.name}.{os.getpid()}")
            new.symlink_to(run.resolve(), target_is_directory=True)
            os.replace(new, link)

    def found(self, *, robot: str | None = None) -> list[tuple[StackFolder, StackState]]:
        """Return all known stacks, or all of one robot, the newest first."""
        stacks = []
        for link in sorted(self._folder.glob("[!.]*")):
            # The run's folder may have been removed, or its link may lead to itself.
            with contextlib.suppress(ConfigError, OSError, RuntimeError):
                stack = StackFolder(link.resolve())
                state = stack.read()
                if robot is None or state.robot == robot:
                    stacks.append((stack, state))
        return sorted(stacks, key=lambda each: each[1].since, reverse=True)

    def current(self, *, robot: str | None = None) -> list[tuple[StackFolder, StackState]]:
        """Return the stacks that run; if none runs, the one that ended last."""
        known = self.found(robot=robot)
        return [each for each in known if each[0].alive] or known[:1]

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Lock the registry, so that two stacks that start at once are added one by one."""
        path = self._folder / ".lock"
        held_by = f"another process has held {path} for {_LOCK_SECONDS:g} s; end it, or try again"
        with hold_private(path, what="up", within=_LOCK_SECONDS, held_by=held_by):
            yield
