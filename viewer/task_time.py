"""The time axes of all plots: the task time of the robot, and the time on its clock.

The robot's rows carry both; the link's and the edge's rows carry only the machine's monotonic
clock, which is the same one. Between two rows of the robot the task time of a message is
interpolated; outside them it runs on at the rate of the clock. In lockstep the clock is the
simulated one, and both axes agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_ANCHORS = 100_000


@dataclass(frozen=True)
class Instants:
    """Instants on both axes [ns], (n,) int64: in the task, and since the robot's first row."""

    task_ns: np.ndarray
    wall_ns: np.ndarray

    def __len__(self) -> int:
        return len(self.task_ns)

    def __getitem__(self, chosen: np.ndarray | slice) -> Instants:
        return Instants(self.task_ns[chosen], self.wall_ns[chosen])

    def repeated(self, times: int) -> Instants:
        """Return the instants, each repeated `times` times."""
        return Instants(np.repeat(self.task_ns, times), np.repeat(self.wall_ns, times))


class TaskTime:
    """The map from the machine's clock to task time, learned from the robot's rows."""

    def __init__(self) -> None:
        self._wall_ns = np.zeros(0, dtype=np.int64)
        self._time_ns = np.zeros(0, dtype=np.int64)
        self._first_wall_ns: int | None = None

    @property
    def known(self) -> bool:
        """Return whether the task has begun."""
        return len(self._wall_ns) > 0

    def instants(self, wall_ns: np.ndarray, time_ns: np.ndarray) -> Instants:
        """Return the instants of the robot's rows; task time is −1 before the task begins."""
        if self._first_wall_ns is None:
            self._first_wall_ns = int(wall_ns[0])
        return Instants(time_ns, wall_ns - self._first_wall_ns)

    def learn(self, wall_ns: np.ndarray, time_ns: np.ndarray, *, every: int = 50) -> None:
        """Keep a pair of clocks from every `every` rows of the running robot, and the last."""
        kept = np.unique(np.append(np.arange(0, len(wall_ns), every), len(wall_ns) - 1))
        self._wall_ns = np.append(self._wall_ns, wall_ns[kept])[-MAX_ANCHORS:]
        self._time_ns = np.append(self._time_ns, time_ns[kept])[-MAX_ANCHORS:]

    def from_wall(self, wall_ns: np.ndarray) -> Instants:
        """Return instants for times of the clock [ns]; task time is negative before the task.

        Call this once the task has begun.
        """
        first, last = self._wall_ns[0], self._wall_ns[-1]
        inside = np.clip(wall_ns, first, last)
        interpolated = np.interp(inside - first, self._wall_ns - first, self._time_ns)
        task_ns = np.rint(interpolated).astype(np.int64) + (wall_ns - inside)
        return self.instants(wall_ns, task_ns)
