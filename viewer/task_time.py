"""One time axis for all plots: the task time of the robot.

The robot's rows carry both its clock and the task time; the link's and the edge's rows carry only
the machine's monotonic clock, which is the same one. Between two rows of the robot the task time of
a message is interpolated, outside them it runs on at the rate of the clock.
"""

from __future__ import annotations

import numpy as np

MAX_ANCHORS = 100_000


class TaskTime:
    """The map from the machine's clock to task time, learned from the robot's rows."""

    def __init__(self) -> None:
        self._wall_ns = np.zeros(0, dtype=np.int64)
        self._time_ns = np.zeros(0, dtype=np.int64)

    @property
    def known(self) -> bool:
        """Whether the task has begun."""
        return len(self._wall_ns) > 0

    def learn(self, wall_ns: np.ndarray, time_ns: np.ndarray, *, every: int = 50) -> None:
        """Take a pair of clocks out of every `every` rows of the running robot, and the last."""
        kept = np.unique(np.append(np.arange(0, len(wall_ns), every), len(wall_ns) - 1))
        self._wall_ns = np.append(self._wall_ns, wall_ns[kept])[-MAX_ANCHORS:]
        self._time_ns = np.append(self._time_ns, time_ns[kept])[-MAX_ANCHORS:]

    def from_wall(self, wall_ns: np.ndarray) -> np.ndarray:
        """Task time of instants of the clock [ns], int64; negative before the task began."""
        first, last = self._wall_ns[0], self._wall_ns[-1]
        inside = np.clip(wall_ns, first, last)
        interpolated = np.interp(inside - first, self._wall_ns - first, self._time_ns)
        return np.rint(interpolated).astype(np.int64) + (wall_ns - inside)
