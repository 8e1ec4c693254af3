"""The posture at which to factorise a moving robot: without the noise, and a little ahead."""

from __future__ import annotations

import math

import numpy as np

# A velocity predicts a position for at most this time [s].
_LEAD_SECONDS = 0.05
# A joint this far from its prediction [rad] is a fault of its sensor, unless it stays there.
_JUMP = 0.5


class PostureEstimate:
    """Joint positions [rad], carried on by the measured velocities, their noise averaged out.

    `now` (nv − 6,) is where the joints are. The time constant of the average is `average_ns`;
    because it corrects a prediction, it does not lag behind a steady motion. The average ignores a
    joint that jumps. If jumps last longer than a prediction holds, the average begins anew.
    """

    def __init__(self, average_ns: int) -> None:
        self._average = average_ns * 1e-9
        self.now = np.zeros(0)
        self._v = np.zeros(0)
        self._stamp_ns: int | None = None
        self._jumped_ns: int | None = None

    def observe(self, q: np.ndarray, v: np.ndarray, *, stamp_ns: int) -> None:
        """A newer state: q (nq,), v (nv,), when it was measured [ns]."""
        measured = q[7:]
        seconds = math.inf if self._stamp_ns is None else (stamp_ns - self._stamp_ns) * 1e-9
        if self._average > 0.0 and 0.0 <= seconds < _LEAD_SECONDS:
            carried = self.now + seconds * self._v
            gain = -math.expm1(-seconds / self._average)
            moved = measured - carried
            jumps = np.abs(moved) > _JUMP
            if not jumps.any():
                self._jumped_ns = None
            elif self._jumped_ns is None:
                self._jumped_ns = stamp_ns
            if self._jumped_ns is None or (stamp_ns - self._jumped_ns) * 1e-9 < _LEAD_SECONDS:
                moved[jumps] = 0.0
                self.now = carried + gain * moved
            else:
                self._begin(measured)
        else:  # also for the first state, after a gap, and after a new start of the robot
            self._begin(measured)
        self._v, self._stamp_ns = v[6:], stamp_ns

    def _begin(self, measured: np.ndarray) -> None:
        self.now, self._jumped_ns = measured.copy(), None

    def ahead(self, distance: float) -> np.ndarray:
        """Joint positions after a motion of `distance` [rad], root mean square over the joints; (nv
        − 6,).

        The positions are less far ahead if the velocities cannot predict that far.
        """
        speed = math.sqrt(self._v @ self._v / len(self._v))
        seconds = min(distance / speed, _LEAD_SECONDS) if speed > 0.0 else 0.0
        return self.now + seconds * self._v
