"""Other stacks on this machine: the processes of robots that are not of this run."""

from __future__ import annotations

import contextlib
from collections.abc import Collection
from pathlib import Path

_PROC = Path("/proc")
# Each running stack has one of these: its robot, or after the robot's end the recording. An edge
# without a robot computes nothing.
_WORKING = (b"\0-m\0robot_node\0", b"\0-m\0viewer\0record\0")


class Neighbours:
    """Counts the other stacks of all users on this machine. `most` is the largest number so far."""

    def __init__(self, proc: Path = _PROC) -> None:
        self.most = 0
        self._proc = proc

    def look(self, own: Collection[int]) -> None:
        """Count once. `own` are the process numbers of this run's services."""
        found = [pid for pid in self._working() if pid not in own]
        self.most = max(self.most, len(found))

    def _working(self) -> list[int]:
        """Return a process number for every stack; none on a system without /proc."""
        working = []
        for folder in self._proc.glob("[0-9]*"):
            # A process may end at any moment.
            with contextlib.suppress(OSError):
                command = (folder / "cmdline").read_bytes()
                if any(words in command for words in _WORKING):
                    working.append(int(folder.name))
        return working
