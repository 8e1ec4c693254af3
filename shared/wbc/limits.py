"""The robot's own limits as rows of the QP: joint torques, joint positions, joint velocities.

With the unknowns y = (a, f) the limited quantities x are, all torques first,

    x_τ = (M_a a + h_a − (J_cᵀ G)_a f) / τ̄ within ±1,
    x_a = a of the joints, within bounds from their positions and velocities.

τ̄ is a little below the clamp. The bounds let a joint come to rest before its limit: a ≤ λ² (q̄ − q)
− 2 λ q̇ keeps q below q̄, and a ≤ λ (v̄ − q̇) keeps q̇ below v̄.

A limit never makes the QP infeasible, because it may be missed at a price, ½ ω (x − bound)², far
above the tasks' weights. Velocities soften first: their bounds are moved to those of the positions.
Then positions and torques share a conflict by their prices: one per cent of a torque limit costs as
much as 0.3 rad/s². The robot clamps the torques. Dynamics, contacts and friction never soften.
"""

from __future__ import annotations

import numpy as np

from shared.config.settings import LimitsConfig, RunConfig
from shared.robots import Robot
from shared.wbc.model import Kinematics

# Prices ω: of a torque [1/τ̄²], of an acceleration [s⁴/rad²].
_TORQUE_PRICE, _JOINT_PRICE = 1e5, 1e2
# λ [1/s], and the largest acceleration that a bound asks for [rad/s²].
_RATE, _HARDEST = 20.0, 100.0
_UNLIMITED = 1e9
# A quantity so far from its bound counts as near, [1] and [rad/s²]. A projector leaves at most so
# many limits open: near ones, and active ones. A message has room for two such projectors.
_TORQUE_NEAR, _JOINT_NEAR = 0.5, 50.0
_MOST_NEAR, MOST_OPEN = 8, 40


class Limits:
    """The limits of one robot, n_x = 2 (nv − 6) rows of which those of a kind that is off are free.

    `clamp` (nv − 6,) [N m] is the limit on a commanded torque. `torque_scale` (nv − 6,) is 1/τ̄.
    `slack` (n_x,) is 1/ω.
    """

    def __init__(self, robot: Robot, config: LimitsConfig, *, torque_clamp: float) -> None:
        n = len(robot.effort_limit)
        self.n_entries = 4 * n
        self.clamp = torque_clamp * robot.effort_limit
        self.torque_scale = 1.0 / (config.torque_fraction * self.clamp)
        self.slack = np.repeat([1.0 / _TORQUE_PRICE, 1.0 / _JOINT_PRICE], n)
        self._near = np.tile(np.repeat([_TORQUE_NEAR, _JOINT_NEAR], n), 2)
        self._config = config
        # Lower and upper bounds, torques then joints.
        self._lower, self._upper = np.full(2 * n, -_UNLIMITED), np.full(2 * n, _UNLIMITED)
        if config.torque:
            self._lower[:n], self._upper[:n] = -1.0, 1.0
        self._lowest_acceleration, self._highest_acceleration = self._lower[n:], self._upper[n:]
        self._limits_joints = config.position or config.velocity
        lowest, highest = robot.position_limit
        self._lowest = _RATE**2 * (lowest + config.position_margin)
        self._highest = _RATE**2 * (highest - config.position_margin)
        self._fastest = _RATE * robot.velocity_limit
        self._slowest = -self._fastest
        self._hardest = np.full(n, _HARDEST)
        self._hardest_back = -self._hardest
        self._x = np.zeros(2 * n)
        self._torques, self._accelerations = self._x[:n], self._x[n:]

    @staticmethod
    def of(robot: Robot, config: RunConfig) -> Limits | None:
        """Return the limits that a configuration asks for, or None if it asks for none."""
        limits = config.wbc.limits
        if not (limits.torque or limits.position or limits.velocity):
            return None
        return Limits(robot, limits, torque_clamp=config.robot.torque_clamp)

    def write_misses(self, rows: np.ndarray, kinematics: Kinematics) -> None:
        """Set `rows` (2 n_x,) to lower − x, then x − upper; positive is beyond a bound.

        As in b, x is that of y = 0 or of the solution whose kinematics these are.
        """
        np.multiply(kinematics.force[6:], self.torque_scale, self._torques)
        if kinematics.a is None:
            self._accelerations.fill(0.0)
        else:
            self._accelerations[:] = kinematics.a[6:]
        if self._limits_joints:
            self._bound_joints(kinematics.q[7:], kinematics.v[6:])
        n_x = len(self._x)
        np.subtract(self._lower, self._x, rows[:n_x])
        np.subtract(self._x, self._upper, rows[n_x:])

    def misses(self, of_b: np.ndarray, force: np.ndarray, a: np.ndarray) -> np.ndarray:
        """The misses (2 n_x,) at a solution, from the entries of b at the same state.

        `force` (nv,) is the generalised force of the solution, `a` (nv,) are its accelerations.
        """
        n = len(self.clamp)
        torques, accelerations = force[6:] * self.torque_scale, a[6:]
        misses = of_b.copy()
        np.subtract(self._lower[:n], torques, misses[:n])
        misses[n : 2 * n] -= accelerations
        np.subtract(torques, self._upper[:n], misses[2 * n : 3 * n])
        misses[3 * n :] += accelerations
        return misses

    def near(self, misses: np.ndarray, active: np.ndarray) -> np.ndarray:
        """The active limits and the nearest of the others, which a late robot may meet next.

        `misses` (2 n_x,) are those of the optimum.
        """
        distance = misses / self._near
        distance[active] = np.inf
        most = min(max(_MOST_NEAR, len(active)), MOST_OPEN)
        closest = np.argsort(-distance, kind="stable")[:most]
        near: np.ndarray = np.sort(closest[distance[closest] > -1.0])
        return near

    def _bound_joints(self, positions: np.ndarray, rates: np.ndarray) -> None:
        lower, upper = self._lowest_acceleration, self._highest_acceleration
        if self._config.velocity:
            braking = _RATE * rates
            np.subtract(self._slowest, braking, lower)
            np.subtract(self._fastest, braking, upper)
        if self._config.position:
            braking = _RATE**2 * positions
            braking += 2.0 * _RATE * rates
            lowest, highest = self._lowest - braking, self._highest - braking
            if self._config.velocity:
                for bound in (lower, upper):
                    np.maximum(bound, lowest, bound)
                    np.minimum(bound, highest, bound)
            else:
                lower[:], upper[:] = lowest, highest
        np.minimum(lower, self._hardest, lower)
        np.maximum(upper, self._hardest_back, upper)
