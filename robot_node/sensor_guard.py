"""Holds over measurements that no motion explains: a sensor fault must not become a torque.

From one tick to the next a position moves by what the velocity says. A sample that is elsewhere, or
that is not a number, is a fault of that sensor: position and velocity are held over. Each joint is
a sensor, and so is the base. A fault that lasts is passed on after 50 ms, when a prediction is
worth no more; the robot's ladder then decides.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from shared.config.settings import SensorConfig
from shared.robots import Robot

HELD_OVER_TICKS = 50
# Least difference from the expected position that is a fault [rad, m], and on top of it in standard
# deviations of the noise.
_JUMP, _NOISE = 0.05, 10.0
# A base that is faster is looked at more closely [m/s, rad/s].
_FAST = 20.0
BASE = "base"


class SensorGuard:
    """Checks every measured state. `faults` counts the samples held over, by the joint's name."""

    def __init__(self, robot: Robot, config: SensorConfig, *, period_ns: int) -> None:
        self.faults: Counter[str] = Counter()
        self._period = period_ns * 1e-9
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
            # All sensors at once, first. A number that is none fails too.
            if not (jump.dot(jump) <= self._jump**2 and of_base.dot(of_base) <= _FAST**2):
                q, v = self._replaced(q, v, jump, last)
            elif self._faulty:
                self._faulty = False
                self._ticks.fill(0)
        self._q, self._v = q, v
        return q, v

    def _replaced(
        self, q: np.ndarray, v: np.ndarray, jump: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        # Written so that a number that is none is no explanation. After one that was passed on, any
        # number is welcome.
        explained = np.empty(len(self._names), dtype=bool)
        explained[0] = self._base_moves(jump, v) or not np.isfinite(last[:7]).all()
        explained[1:] = (np.abs(jump[7:]) <= self._jump) | ~np.isfinite(last[7:])
        number = np.isfinite(q[7:]) & np.isfinite(v[6:])
        explained[1:] &= number
        explained[0] &= np.isfinite(q[:7]).all() and np.isfinite(v[:6]).all()
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
        return q, v

    def _base_moves(self, jump: np.ndarray, v: np.ndarray) -> bool:
        """Return whether the base has moved and turned by as much as its velocity says."""
        moved, turned = (math.sqrt(part.dot(part)) for part in (jump[:3], jump[3:7]))
        speed, rate = (self._period * math.sqrt(part.dot(part)) for part in (v[:3], v[3:6]))
        if not math.isfinite(speed + rate):
            return False
        # The chord between the quaternions before and after a turn by an angle.
        chord = 2.0 * abs(math.sin(0.25 * rate))
        return abs(moved - speed) <= _JUMP and abs(turned - chord) <= _JUMP
