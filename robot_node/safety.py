"""The guards between a computed torque and the actuators, and the joint hold without a torque."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.robots import Robot
from shared.robots.standing import standing_torques
from shared.wbc.finite import all_finite

# Joint hold: stiffness [1/rad] and damping [s/rad] per N m of the joint's effort limit, at most.
_HOLD_STIFFNESS_PER_EFFORT = 20.0
_HOLD_DAMPING_PER_EFFORT = 1.0
# Part of a joint's velocity that its damping may take away in one tick. Above 2 a joint that moves
# freely swings up instead of coming to rest.
_HOLD_DAMPING_PER_TICK = 0.5
# Weight of the newest tick in the average: a time constant of 50 ms.
_HOLD_AVERAGE = 0.02
# Time in which the joints move to the standing posture, on both feet and from a step, and that a
# hold from a step lasts at least [s].
_STRAIGHTEN, _SET_DOWN, _LEAST_ON_ONE_FOOT = 0.3, 0.15, 0.25


class TorqueGuard:
    """Clamps to actuator limits and refuses numbers that are not finite."""

    def __init__(self, robot: Robot, *, clamp: float) -> None:
        self.limit = clamp * robot.effort_limit
        self._lowest = -self.limit

    def accept(self, tau: np.ndarray) -> np.ndarray | None:
        """`tau` clamped, shape (nv − 6,) [N m]; None if any entry is not finite."""
        if not all_finite(tau):
            return None
        clamped: np.ndarray = np.minimum(np.maximum(tau, self._lowest), self.limit)
        return clamped


class TorqueRateLimiter:
    """Bounds the torque step when the robot changes the rung of its ladder.

    From there on each joint torque moves by at most a tenth of its limit per tick, until it has
    caught up with the command.
    """

    _STEP = 0.1

    def __init__(self, guard: TorqueGuard) -> None:
        self._step = self._STEP * guard.limit
        self._last: np.ndarray | None = None
        self._following = True

    def bound(self, tau: np.ndarray, *, changed: bool) -> np.ndarray:
        """The torque to apply (nv − 6,) [N m]; `changed`: the first tick on another rung."""
        if self._last is not None and (changed or not self._following):
            jump = tau - self._last
            self._following = bool(np.all(np.abs(jump) <= self._step))
            if not self._following:
                tau = self._last + np.minimum(np.maximum(jump, -self._step), self._step)
        self._last = tau
        return tau


class JointHold:
    """Holds the joints around the torques that bear the standing robot.

    It is the last resort of a robot without a usable projector: the robot stays upright like a
    statue, and resists as far as stiff joints can. The held posture is the average over the last
    ticks, because a single measurement is noisy. The torques of those ticks do not count, because
    they may come from an old projector that is about to let the robot fall.

    If the feet stand as in the standing posture, the joints move to it, and the CoM above the
    middle of the feet. If they stand elsewhere, the joints stay, because the feet would slide. A
    statue on one foot would topple. A hold that begins in a step therefore moves the joints to the
    standing posture, in which both feet are on the ground.

    The gains are those of a joint as strong as its effort limit, and no more than a tick of
    `timestep` [s] allows for its inertia. A light joint would otherwise chatter, and shake the feet
    along the floor. The stiffness is at most that of critical damping.
    """

    def __init__(self, robot: Robot, *, timestep: float) -> None:
        self._timestep = timestep
        self._standing = robot.q_standing[7:]
        self._bearing = standing_torques(robot)
        inertia = _free_inertia(robot)
        self._damping = np.minimum(
            _HOLD_DAMPING_PER_EFFORT * robot.effort_limit,
            _HOLD_DAMPING_PER_TICK * inertia / timestep,
        )
        self._stiffness = np.minimum(
            _HOLD_STIFFNESS_PER_EFFORT * robot.effort_limit, self._damping**2 / (4.0 * inertia)
        )
        self._average = self._standing.copy()
        self._on_both_feet = self._feet_as_standing = True
        self._ticks = 0

    def observe(
        self, q: np.ndarray, *, on_both_feet: bool = True, feet_as_standing: bool = True
    ) -> None:
        """Take in a tick under normal control at measured q (nq,).

        `feet_as_standing`: no step has moved the feet from where the standing posture has them.
        """
        self._on_both_feet, self._feet_as_standing = on_both_feet, feet_as_standing
        self._ticks = 0
        self._average += _HOLD_AVERAGE * (q[7:] - self._average)

    @property
    def seconds(self) -> float:
        """The time since the last tick under normal control [s]."""
        return self._ticks * self._timestep

    @property
    def sets_foot_down(self) -> bool:
        """Return whether the hold has begun on one foot and the other one is not down yet."""
        return not self._on_both_feet and 0.0 < self.seconds < _LEAST_ON_ONE_FOOT

    def torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Holding torque at (q, v) in the next tick of a hold, shape (nv − 6,) [N m]."""
        self._ticks += 1
        posture = self._average
        if self._feet_as_standing or not self._on_both_feet:
            within = _STRAIGHTEN if self._on_both_feet else _SET_DOWN
            part = min(1.0, self.seconds / within)
            posture = posture + part * (self._standing - posture)
        torque: np.ndarray = (
            self._bearing + self._stiffness * (posture - q[7:]) - self._damping * v[6:]
        )
        # A joint without a measurement gets the torque that bears the standing robot.
        if not all_finite(torque):
            torque = np.where(np.isfinite(torque), torque, self._bearing)
        return torque


def _free_inertia(robot: Robot) -> np.ndarray:
    """Inertia against a joint's torque if nothing holds the robot, (nv − 6,) [kg m²]."""
    data = robot.model.createData()
    M_inverse = pin.computeMinverse(robot.model, data, robot.q_standing)
    inertia: np.ndarray = 1.0 / np.diag(M_inverse)[6:]
    return inertia
