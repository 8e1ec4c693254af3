"""Replace measurements that no motion explains, so that no sensor fault becomes a torque.

From one tick to the next a position changes as the velocity says. Any other sample, or one that is
not a number, is a fault of that sensor, and the last position and velocity are held over. Each
joint is a sensor, and so is the base. After 50 ms a lasting fault is passed on, because a
prediction is of no more use then. A value that no robot can have is passed on as NaN, until one
comes that a robot can have. The robot's ladder then decides.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from shared.config.robot_settings import SensorConfig
from shared.robots import Robot
from shared.robots.state_limits import StateLimits
from shared.wbc.continuity import continues

HELD_OVER_TICKS = 50
# A larger difference from the expected position is a fault [rad, m]. Standard deviations of the
# noise are added to it.
_JUMP, _NOISE = 0.05, 10.0
# The base is checked more closely above these speeds [m/s, rad/s].
_FAST = 20.0
BASE = "base"


class SensorGuard:
    """Checks every measured state. `faults` counts the samples held over, by the joint's name."""

    def __init__(self, robot: Robot, config: SensorConfig, *, period_ns: int) -> None:
        self.faults: Counter[str] = Counter()
        self._period = period_ns * 1e-9
        self._limits = StateLimits(robot)
        self._names = (BASE, *robot.model.names[2:])
        noise = config.joint_position_noise + self._period * config.joint_velocity_noise
        self._jump = _JUMP + _NOISE * noise
        self._q: np.ndarray | None = None
        self._v = np.zeros(robot.model.nv)
        # Ticks for which each sensor has been at fault, the base first.
        self._ticks = np.zeros(len(self._names), dtype=int)
        self._faulty = False

    def check(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the measured state with faulty samples replaced; q (nq,), v (nv,)."""
        last = self._q
        if last is not None:
            jump = q - last
            of_joints, of_base = jump[7:], v[:6]
            of_joints -= self._period * v[6:]
            # First a check of all sensors at once, which a NaN fails too.
            if not (jump.dot(jump) <= self._jump**2 and of_base.dot(of_base) <= _FAST**2):
                q, v = self._replaced(q, v, last)
            elif self._faulty:
                self._faulty = False
                self._ticks.fill(0)
        self._q, self._v = q, v
        return q, v

    def _replaced(
        self, q: np.ndarray, v: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        explained = continues(last, q, v, seconds=self._period, jump=self._jump)
        # After a NaN that was passed on, any value that the robot can have is accepted.
        known, possible = np.isfinite(last), self._limits.possible(q, v)
        explained[0] |= possible[0] and not known[:7].all()
        explained[1:] |= possible[1:] & ~known[7:]
        self._faulty = True
        self._ticks[explained] = 0
        self._ticks[~explained] += 1
        q, v = q.copy(), v.copy()
        for sensor in np.flatnonzero(~explained & (self._ticks <= HELD_OVER_TICKS)):
            self.faults[self._names[sensor]] += 1
            if sensor == 0:
                q[:7], v[:6] = last[:7], self._v[:6]
            else:
                joint = 5 + sensor
                v[joint] = self._v[joint]
                q[joint + 1] = last[joint + 1] + self._period * v[joint]
        for sensor in np.flatnonzero(~explained & ~possible & (self._ticks > HELD_OVER_TICKS)):
            q[slice(7) if sensor == 0 else 6 + sensor] = np.nan
        return q, v
