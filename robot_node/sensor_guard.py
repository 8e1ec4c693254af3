"""Replace measurements that no motion explains, so that no sensor fault becomes a torque.

From one tick to the next a position changes as the velocity says. Any other sample, or one that is
not a number, is a fault of that sensor, and the last position and velocity are held over. Each
joint is a sensor, and so is the base. After 50 ms a lasting fault of a joint is passed on, because
a prediction is of no more use then. A value that no robot can have is passed on as NaN, until one
comes that a robot can have. The robot's ladder then decides.

A base that jumps and stays there is no fault of its place: the frame of its estimate has moved, as
when a SLAM relocalises or an estimator begins anew. The robot has not moved with it. After the
50 ms the guard therefore measures the base in the moved frame, in which it is where it was held
over. Gravity shows which way is up in every frame, so a jump in roll or pitch is passed on.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pinocchio as pin

from shared.config.robot_settings import SensorConfig
from shared.motion.plan_frame import PlanFrame
from shared.robots import Robot
from shared.robots.state_limits import StateLimits
from shared.wbc.continuity import continues

HELD_OVER_TICKS = 50
# A larger difference from the expected position is a fault [rad]. Standard deviations of the noise
# are added to it.
_JUMP, _NOISE = 0.05, 10.0
# The same for the base [m, part of a quaternion].
_BASE_JUMP = 0.02
# The base is checked more closely above these speeds [m/s, rad/s].
_FAST = 20.0
BASE = "base"


class SensorGuard:
    """Checks every measured state.

    `faults` counts the samples held over, by the joint's name. `base_jumps` counts how often the
    frame of the base's estimate has moved.
    """

    def __init__(self, robot: Robot, config: SensorConfig, *, period_ns: int) -> None:
        self.faults: Counter[str] = Counter()
        self.base_jumps = 0
        self._model = robot.model
        self._period = period = period_ns * 1e-9
        self._limits = StateLimits(robot)
        self._names = (BASE, *robot.model.names[2:])
        noise = config.joint_position_noise + period * config.joint_velocity_noise
        self._jump = _JUMP + _NOISE * noise
        of_place = config.base_position_noise + period * config.base_velocity_noise
        of_place += math.sqrt(period) * config.base_position_drift
        of_turn = config.tilt_noise + period * config.gyro_noise
        self._base_jump = _BASE_JUMP + _NOISE * max(of_place, of_turn)
        # The robot's world in the world of the estimate.
        self._frame = PlanFrame()
        self._q: np.ndarray | None = None
        self._v = np.zeros(robot.model.nv)
        # The base where it was known last, if it is unknown now, and the ticks since then.
        self._base: np.ndarray | None = None
        self._unknown_ticks = 0
        # Ticks for which each sensor has been at fault, the base first.
        self._ticks = np.zeros(len(self._names), dtype=int)
        self._faulty = False

    def check(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the measured state with faulty samples replaced; q (nq,), v (nv,)."""
        q = self._frame.in_plan(q)
        last = self._q
        if last is not None:
            jump = q - last
            of_joints, of_base = jump[7:], v[:6]
            of_joints -= self._period * v[6:]
            base = jump[:7]
            # First a check of all sensors at once, which a NaN fails too.
            if not (
                jump.dot(jump) <= self._jump**2
                and base.dot(base) <= self._base_jump**2
                and of_base.dot(of_base) <= _FAST**2
            ):
                q, v = self._replaced(q, v, last)
            elif self._faulty:
                self._faulty = False
                self._ticks.fill(0)
        self._q, self._v = q, v
        return q, v

    def _replaced(
        self, q: np.ndarray, v: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        explained = continues(
            last, q, v, seconds=self._period, jump=self._jump, base_jump=self._base_jump
        )
        # After a NaN that was passed on, any value that the robot can have is accepted.
        known, possible = np.isfinite(last), self._limits.possible(q, v)
        base_known = known[:7].all()
        explained[0] |= possible[0] and not base_known
        explained[1:] |= possible[1:] & ~known[7:]
        self._faulty = True
        self._ticks[explained] = 0
        self._ticks[~explained] += 1
        q, v = q.copy(), v.copy()
        for sensor in np.flatnonzero(~explained & (self._ticks <= HELD_OVER_TICKS)):
            self.faults[self._names[sensor]] += 1
            if sensor == 0:
                q[:7], v[:6] = self._carried_on(last), self._v[:6]
            else:
                joint = 5 + sensor
                v[joint] = self._v[joint]
                q[joint + 1] = last[joint + 1] + self._period * v[joint]
        lasting = ~explained & (self._ticks > HELD_OVER_TICKS)
        if lasting[0] and possible[0]:
            self._follow_frame(q, self._carried_on(last))
        elif lasting[0]:
            if base_known:
                self._base, self._unknown_ticks = last[:7].copy(), 0
            self._unknown_ticks += 1
        elif not base_known and explained[0]:
            self._come_back(q, v)
        for sensor in np.flatnonzero(lasting & ~possible):
            q[slice(7) if sensor == 0 else 6 + sensor] = np.nan
        return q, v

    def _carried_on(self, last: np.ndarray) -> np.ndarray:
        """The base (7,) a tick after `last` (nq,) at the last velocity."""
        carried: np.ndarray = pin.integrate(self._model, last, self._period * self._v)[:7]
        return carried

    def _come_back(self, q: np.ndarray, v: np.ndarray) -> None:
        """Compare a base that was unknown, in q (nq,), with where it was known last."""
        base = self._base
        if base is None:
            return
        before = np.concatenate((base, q[7:]))
        seconds = self._unknown_ticks * self._period
        if not continues(before, q, v, seconds=seconds, jump=self._jump)[0]:
            self._follow_frame(q, base)

    def _follow_frame(self, q: np.ndarray, base: np.ndarray) -> None:
        """Measure the base of q (nq,) in a moved frame, in which it has the place of `base` (7,).

        Do nothing if it has this place already and differs in tilt only.
        """
        measured, place = _place(q), _place(base)
        moved = math.dist((measured.x, measured.y, measured.z), (place.x, place.y, place.z))
        turned = abs(math.remainder(measured.yaw - place.yaw, math.tau))
        if max(moved, turned / 2) <= self._base_jump:
            return
        self.base_jumps += 1
        by_estimate = self._frame.in_world(q)
        self._frame = PlanFrame.between(_place(by_estimate), place)
        q[:7] = self._frame.in_plan(by_estimate)[:7]


def _place(q: np.ndarray) -> PlanFrame:
    """Position and heading of a base (7,)."""
    x, y, z, i, j, k, w = q[:7].tolist()
    return PlanFrame(x, y, math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k)), z)
