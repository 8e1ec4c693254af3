"""Other work on this machine: other stacks, and the cores that other processes take."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection
from pathlib import Path

from deploy.process_stat import processor_seconds

_PROC = Path("/proc")
# Each running stack has one of these: its robot, or after the robot's end the recording. An edge
# without a robot computes nothing.
_WORKING = (b"\0-m\0robot_node\0", b"\0-m\0viewer\0record\0")
# Columns of the first line of /proc/stat that are work: user, nice, system, irq, softirq, and the
# time that a hypervisor gave to others; see proc(5).
_WORK = (1, 2, 3, 6, 7, 8)


class Neighbours:
    """Watches the processes of all users on this machine that do not belong to this run.

    `most` is the largest number of other stacks so far. `cores` is the mean number of cores that
    other processes took between the first and the last look, None before the second look.
    """

    def __init__(self, proc: Path = _PROC) -> None:
        self.most = 0
        self.cores: float | None = None
        self._proc = proc
        self._own_s: dict[int, float] = {}
        self._first: tuple[float, float] | None = None

    def look(self, own: Collection[int], now_s: float) -> None:
        """Look once, at this time of a monotonic clock. `own` are this run's process numbers."""
        found = [pid for pid in self._working() if pid not in own]
        self.most = max(self.most, len(found))
        # A process may end at any moment. There may be no /proc.
        for pid in own:
            with contextlib.suppress(OSError, ValueError):
                self._own_s[pid] = processor_seconds(pid, self._proc)
        with contextlib.suppress(OSError, ValueError, IndexError):
            others_s = self._worked_s() - sum(self._own_s.values())
            if self._first is None:
                self._first = (now_s, others_s)
            elif now_s > self._first[0]:
                self.cores = max(0.0, (others_s - self._first[1]) / (now_s - self._first[0]))

    def _worked_s(self) -> float:
        """Return the time that all cores together have worked since boot [s]."""
        cells = (self._proc / "stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        return sum(int(cells[k]) for k in _WORK) / os.sysconf("SC_CLK_TCK")

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
