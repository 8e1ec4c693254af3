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

from shared.config.control_settings import LimitsConfig
from shared.config.settings import RunConfig
from shared.robots import Robot
from shared.wbc.model import Live

# Prices ω: of a torque [1/τ̄²], of an acceleration [s⁴/rad²].
_TORQUE_PRICE, _JOINT_PRICE = 1e5, 1e2
# λ [1/s], and the largest acceleration that a bound asks for [rad/s²].
_RATE, _HARDEST = 20.0, np.array(100.0)
_SQUARE_RATE, _DOUBLE_RATE = np.array(_RATE**2), np.array(2.0 * _RATE)
_UNLIMITED = 1e9
# A quantity within this distance of its bound counts as near, [1] and [rad/s²]. The number is the
# most limits that a projector leaves open, near and active ones. A message has room for two such
# projectors.
_TORQUE_NEAR, _JOINT_NEAR = 0.5, 50.0
_MOST_NEAR, MOST_OPEN = 8, 40


class Limits:
    """The limits of one robot: n_x = 2 (nv − 6) rows. Rows of a kind that is off have no bounds.

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
        self._limits_joints = config.position or config.velocity
        self._limits_velocity = config.velocity
        # Lower bounds, and upper bounds with a minus, torques then joints. Those of a joint's
        # position are for λ² q + 2 λ q̇ + a instead of a.
        self._lower, self._minus_upper = np.full((2, 2 * n), -_UNLIMITED)
        if config.torque:
            self._lower[:n] = self._minus_upper[:n] = -1.0
        if config.position:
            lowest, highest = robot.position_limit
            self._lower[n:] = _SQUARE_RATE * (lowest + config.position_margin)
            self._minus_upper[n:] = -_SQUARE_RATE * (highest - config.position_margin)
        self._fastest = _RATE * robot.velocity_limit
        self._x = np.zeros(2 * n)
        self._torques, self._braking = self._x[:n], self._x[n:]
        self._of_rates = np.zeros(n)
        # Misses, and views of them: making a view takes as long as a sum.
        self._misses = np.zeros((2, 2 * n))
        self._lower_misses, self._upper_misses = self._misses
        self._of_joints = self._misses[:, n:]
        self._lower_of_joints, self._upper_of_joints = self._of_joints
        self._flat = Live(self._misses.reshape(-1))
        self._sums = [*self._sums_of(-1.0, self._lower), *self._sums_of(1.0, self._minus_upper)]

    @staticmethod
    def of(robot: Robot, config: RunConfig) -> Limits | None:
        """Return the limits that a configuration asks for, or None if it asks for none."""
        limits = config.wbc.limits
        if not (limits.torque or limits.position or limits.velocity):
            return None
        return Limits(robot, limits, torque_clamp=config.robot.torque_clamp)

    def misses(self, q: np.ndarray, v: np.ndarray, a: np.ndarray | None, force: np.ndarray) -> Live:
        """Distances of the quantities beyond their bounds, (2 n_x,): lower − x, then x − upper.

        At (q, v), with the accelerations `a` (nv,), None for zero, and the generalised force of a
        and the contact forces, `force` (nv,). Overwritten by the next call.
        """
        np.multiply(force[6:], self.torque_scale, self._torques)
        if self._limits_joints:
            np.multiply(q[7:], _SQUARE_RATE, self._braking)
            np.multiply(v[6:], _DOUBLE_RATE, self._of_rates)
            np.add(self._braking, self._of_rates, self._braking)
        np.subtract(self._lower, self._x, self._lower_misses)
        np.add(self._minus_upper, self._x, self._upper_misses)
        if self._limits_velocity:
            self._bound_rates(self._of_joints, v[6:])
        if self._limits_joints:
            # With `out` by its name, because numpy is slow to warn of a third position.
            np.minimum(self._of_joints, _HARDEST, out=self._of_joints)
            if a is not None:
                of_joints = a[6:]
                np.subtract(self._lower_of_joints, of_joints, self._lower_of_joints)
                np.add(self._upper_of_joints, of_joints, self._upper_of_joints)
        return self._flat

    def _sums_of(self, sign: float, bounds: np.ndarray) -> list[tuple[float, ...]]:
        """Coefficients of an entry's joint in (q, v, a, force), and the bound, without caps and
        velocities.
        """
        of_torques = [(0.0, 0.0, 0.0, sign * scale) for scale in self.torque_scale.tolist()]
        of_joints = [(sign * _RATE**2, sign * 2.0 * _RATE, sign, 0.0)] * len(of_torques)
        both = zip([*of_torques, *of_joints], bounds.tolist(), strict=True)
        return [(*coefficients, bound) for coefficients, bound in both]

    def clearly_hold(
        self, entries: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray, force: np.ndarray
    ) -> bool:
        """Return whether the `misses` of a few `entries` (k,) are none; False if it is not clear.

        A loop over few numbers takes a third of the time of all misses.
        """
        if self._limits_velocity:
            return False
        n = len(self.clamp)
        for entry in entries.tolist():
            of_q, of_v, of_a, of_force, bound = self._sums[entry]
            joint = entry % n
            rate, turned = joint + 6, joint + 7
            # A cap only makes a miss smaller. Written so that no NaN passes.
            if not (
                of_q * q.item(turned)
                + of_v * v.item(rate)
                + of_a * a.item(rate)
                + of_force * force.item(rate)
                + bound
                <= 0.0
            ):
                return False
        return True

    def _bound_rates(self, joints: np.ndarray, rates: np.ndarray) -> None:
        """Tighten the bounds of accelerations (2, n): the lower bounds, then the negated upper
        bounds.

        A velocity's bound moves to the position's bound if it lies beyond it.
        """
        lowest, highest = joints[0].copy(), -joints[1]
        for bound, fastest in ((joints[0], -self._fastest), (joints[1], self._fastest)):
            np.subtract(fastest, _RATE * rates, bound)
            np.maximum(bound, lowest, out=bound)
            np.minimum(bound, highest, out=bound)
        np.negative(joints[1], joints[1])

    def near(self, misses: np.ndarray, active: np.ndarray) -> np.ndarray:
        """The active limits and the nearest others, which the robot may meet before the next
        answer.

        `misses` (2 n_x,) are those of the optimum.
        """
        distance = misses / self._near
        distance[active] = np.inf
        most = min(max(_MOST_NEAR, len(active)), MOST_OPEN)
        closest = np.argsort(-distance, kind="stable")[:most]
        near: np.ndarray = np.sort(closest[distance[closest] > -1.0])
        return near
