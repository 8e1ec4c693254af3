"""The stacks that were started in the background from this copy of the project.

Each stack has a link to its run's folder. The link's name is `ROBOT.SERVICE+SERVICE`, and the next
stack of the same name replaces it. The links are in `runs/.stacks` of the project's folder. All
installations as a package share `remote-wbc/stacks` in the user's state folder ($XDG_STATE_HOME,
~/.local/state). Stacks that run in a terminal have links in the folder `.terminals` beside them,
named by their process, for commands to a running stack.
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


@contextlib.contextmanager
def in_terminal(run: Path) -> Iterator[None]:
    """Let commands find a stack that runs in a terminal, if its link can be written."""
    folder = _terminals()
    link = folder / f"{os.getpid()}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for old in folder.iterdir():
            # A stack that was killed has left its link.
            if not StackFolder(old.resolve()).alive:
                old.unlink()
        link.unlink(missing_ok=True)
        link.symlink_to(run.resolve(), target_is_directory=True)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            link.unlink()


def running_stacks(*, robot: str | None = None) -> list[tuple[StackFolder, StackState]]:
    """Return all stacks that run, or all of one robot, in the background and in terminals."""
    found = [*Registry().found(robot=robot), *Registry(_terminals()).found(robot=robot)]
    return [each for each in found if each[0].alive]


def _terminals() -> Path:
    return registry_folder() / ".terminals"


class Registry:
    """The links in one folder."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or registry_folder()

    def check(self, run: Path | None, *, robot: str, services: tuple[str, ...]) -> None:
        """Raise `ConfigError` if a stack other than `run` already runs a service of this robot."""
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
