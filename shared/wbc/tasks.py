"""The tasks: one class each, with its Jacobian for the edge and its feedback for both ends.

The rows of b are √ω (s̈* − J̇ v) of Eq. (6). With kinematics at an acceleration a they are √ω (s̈*
− J̇ v − J a). Here s̈* = s̈_ref + kp (s_ref − s) + kd (ṡ_ref − ṡ) and kd = 2 √kp (critical
damping). The robot writes them each millisecond: gains have √ω in them, and rows are written in
place. The stack applies the weight of J.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from shared.robots import GRAVITY, Foot
from shared.robots.fallen import LEAST_COM_HEIGHT
from shared.wbc.model import Jacobians, Kinematics, RowMultipliers
from shared.wbc.reference import Reference, turned

# Acceleration of gravity in the world [m/s²].
_GRAVITY_IN_WORLD = np.array((0.0, 0.0, -GRAVITY))


class Task(Protocol):
    """A linear objective ‖J a − target‖² with weight ω."""

    @property
    def name(self) -> str: ...
    @property
    def size(self) -> int: ...
    @property
    def weight(self) -> float: ...
    @property
    def constant(self) -> bool:
        """Return whether J is the same at every configuration."""
        ...

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        """J, shape (size, nv)."""
        ...

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        """Set `rows` (size,) to √ω (s̈* − J̇ v − J a); a is that of the kinematics."""
        ...

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        """Add Jᵀ `rows` (size,) to a product, as multipliers of the rows of the model that make up
        J at the kinematics.
        """
        ...


@dataclass(frozen=True)
class Gains:
    """√ω times kp, kd and 1."""

    position: float
    velocity: float
    acceleration: float

    @staticmethod
    def of(*, weight: float, kp: float) -> Gains:
        root = math.sqrt(weight)
        return Gains(root * kp, root * 2.0 * math.sqrt(kp), root)

    def array(self) -> np.ndarray:
        """(3,), for errors as rows: position, velocity, acceleration."""
        return np.array([self.position, self.velocity, self.acceleration])


class ComTask:
    """Centre of mass [m], in the base frame: its rows do not change when the robot turns."""

    name = "com"
    size = 3
    constant = False

    def __init__(self, *, weight: float, kp: float) -> None:
        self.weight = weight
        self._gains = Gains.of(weight=weight, kp=kp).array()
        self._error = np.zeros((3, 3))
        self._of_position, self._of_velocity, self._of_acceleration = self._error

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return jacobians.J_com

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        np.subtract(reference.com, kinematics.com, self._of_position)
        np.subtract(reference.com_velocity, kinematics.com_velocity, self._of_velocity)
        np.subtract(reference.com_acceleration, kinematics.com_acceleration, self._of_acceleration)
        if reference.com_command is not None:
            self._error[:2, :2] = 0.0
            asked = reference.com_command
            np.subtract(asked, kinematics.com_acceleration[:2], self._of_acceleration[:2])
        # A row times R is Rᵀ times the column: from the world to the base.
        self._gains.dot(self._error).dot(kinematics.world_from_base, rows)

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        multipliers.com += rows


class BaseOrientationTask:
    """Orientation of the base, error in the base frame [rad]."""

    name = "base_orientation"
    size = 3
    constant = True

    def __init__(self, *, weight: float, kp: float, nv: int) -> None:
        self.weight = weight
        self._gains = Gains.of(weight=weight, kp=kp)
        self._jacobian = np.eye(nv)[3:6]

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return self._jacobian

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        gains = self._gains
        base_from_reference = kinematics.world_from_base.T.dot(reference.world_from_base)
        np.multiply(pin.log3(base_from_reference), gains.position, rows)
        rows -= gains.velocity * kinematics.v[3:6]
        if kinematics.a is not None:
            rows -= gains.acceleration * kinematics.a[3:6]

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        multipliers.joints[3:6] += rows


class PostureTask:
    """Joint positions [rad]."""

    name = "posture"
    constant = True

    def __init__(self, *, weight: float, kp: float, nv: int) -> None:
        self.weight = weight
        self._gains = Gains.of(weight=weight, kp=kp)
        self.size = nv - 6
        self._jacobian = np.eye(nv)[6:]

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return self._jacobian

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        gains = self._gains
        np.subtract(reference.posture, kinematics.q[7:], rows)
        rows *= gains.position
        rows -= gains.velocity * kinematics.v[6:]
        if kinematics.a is not None:
            rows -= gains.acceleration * kinematics.a[6:]

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        multipliers.joints[6:] += rows


class AngularMomentumTask:
    """Angular momentum about the CoM [kg m²/s], in the base frame, with zero as its reference.

    J is the angular part of the centroidal momentum matrix, and s̈* = −kp L, as in TSID.
    """

    name = "angular_momentum"
    size = 3
    constant = False

    def __init__(self, *, weight: float, kp: float) -> None:
        self.weight = weight
        self._root = math.sqrt(weight)
        self._kp = kp

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return _angular_momentum_rows(jacobians)

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        momentum, rate = kinematics.angular_momentum()
        asked = self._kp * momentum + rate
        asked *= -self._root
        asked.dot(kinematics.world_from_base, rows)

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        multipliers.add_angular_momentum(rows)


class CopTask:
    """Centre of pressure (CoP) in the plane of a loaded sole, as in TSID, but by accelerations.

    The moment of the contact forces about the point below the CoM, over m h, is

        (c̈ − g − e_z × L̇ / (m h))_xy = F_z / (m h) (c − p)_xy

    in the sole frame, with the CoM c, its height h over the sole, and the CoP p. The rows ask for
    the reference's p. Its F, m (c̈_ref − g), leaves p and passes through its CoM.
    """

    name = "cop"
    size = 2
    constant = False

    def __init__(self, *, weight: float, mass: float, foot: Foot) -> None:
        self.weight = weight
        self._root = math.sqrt(weight)
        self._mass = mass
        self._foot = foot

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        J_sole, J_com = jacobians.J_sole[self._foot][:3], jacobians.J_com
        sole_from_base = J_sole[:, :3]
        # [c]ₓ and [p]ₓ, of the CoM and the sole in the base frame, are in the columns of turns.
        lever = sole_from_base.T @ J_sole[:, 3:6] - J_com[:, 3:6]
        com_from_sole = np.array((lever[2, 1], lever[0, 2], lever[1, 0]))
        mass_height = self._mass * _height(sole_from_base[2] @ com_from_sole)
        rows: np.ndarray = sole_from_base[:2] @ J_com
        turn = sole_from_base[:2] @ _angular_momentum_rows(jacobians)
        rows[0] += turn[1] / mass_height
        rows[1] -= turn[0] / mass_height
        return rows

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        sole = kinematics.sole_placement(self._foot)
        sole_from_world = sole.rotation.T
        com = sole_from_world.dot(kinematics.com - sole.translation)
        height = _height(com[2])
        command, acceleration = reference.com_command, reference.com_acceleration
        if command is None:
            force = sole_from_world.dot(acceleration - _GRAVITY_IN_WORLD)
            com_reference = sole_from_world.dot(reference.com - sole.translation)
            cop = com_reference - force * (com_reference[2] / force[2])
            asked = (com - cop) * (force[2] / height)
        else:
            # From the law's CoP its force passes through the CoM.
            asked = sole_from_world.dot(np.append(command, acceleration[2]) - _GRAVITY_IN_WORLD)
        asked -= sole_from_world.dot(kinematics.com_acceleration - _GRAVITY_IN_WORLD)
        _, rate = kinematics.angular_momentum()
        turn = sole_from_world.dot(rate) / (self._mass * height)
        rows[0] = self._root * (asked[0] - turn[1])
        rows[1] = self._root * (asked[1] + turn[0])

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        sole = kinematics.sole_placement(self._foot)
        base_from_sole = kinematics.world_from_base.T.dot(sole.rotation)
        height = _height(sole.rotation[:, 2].dot(kinematics.com - sole.translation))
        multipliers.com += base_from_sole[:, :2].dot(rows)
        turned = np.array((-rows[1], rows[0])) / (self._mass * height)
        multipliers.add_angular_momentum(base_from_sole[:, :2].dot(turned))


class SwingFootTask:
    """Pose of the swing foot, in its sole frame: position [m], then orientation [rad]."""

    name = "swing_foot"
    size = 6
    constant = False

    def __init__(self, *, weight: float, kp: float, foot: Foot) -> None:
        self.weight = weight
        self.foot = foot
        self._gains = gains = Gains.of(weight=weight, kp=kp)
        self._gain_array = gains.array()
        # Position, velocity, acceleration asked of the sole's origin, in the world; and what they
        # and the heading ask of the sole's linear and angular acceleration.
        self._errors = np.zeros((3, 3))
        self._of_position, self._of_velocity, self._of_acceleration = self._errors
        self._in_world = np.zeros((2, 3))
        # The terms of the rows, in the sole frame, each with its factor.
        self._terms = np.zeros((5, 6))
        self._asked, self._velocity, self._acceleration, self._turning, self._tilt = self._terms
        self._factors = np.array(
            [1.0, -gains.velocity, -gains.acceleration, -gains.acceleration, gains.position]
        )

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return jacobians.J_sole[self.foot]

    def write_target(self, rows: np.ndarray, kinematics: Kinematics, reference: Reference) -> None:
        gains, swing = self._gains, reference.swing
        self._acceleration[:] = kinematics.sole_acceleration[self.foot]
        if swing is None:  # the plan has this foot on the ground: keep it where it is
            np.multiply(self._acceleration, -gains.acceleration, rows)
            return
        placement = kinematics.sole_placement(self.foot)
        R = placement.rotation
        np.subtract(swing.position, placement.translation, self._of_position)
        self._of_velocity[:] = swing.velocity
        self._of_acceleration[:] = swing.acceleration
        linear, angular = self._in_world
        self._gain_array.dot(self._errors, linear)
        angular[2] = gains.velocity * swing.yaw_rate + gains.acceleration * swing.yaw_acceleration
        self._in_world.dot(R, self._asked.reshape(2, 3))
        self._velocity[:] = velocity = kinematics.sole_velocity[self.foot]
        # The rows hold spatial accelerations: a point's acceleration less ω × v.
        self._turning[:3] = _cross(velocity[3:], velocity[:3])
        self._tilt[3:] = pin.log3(R.T.dot(turned(swing.yaw)))
        self._factors.dot(self._terms, rows)

    def add_transposed(
        self, rows: np.ndarray, multipliers: RowMultipliers, kinematics: Kinematics
    ) -> None:
        multipliers.soles[self.foot] = multipliers.soles.get(self.foot, 0.0) + rows


def _angular_momentum_rows(jacobians: Jacobians) -> np.ndarray:
    """The angular part of the centroidal momentum matrix, (3, nv), in the base frame."""
    # J_com = (I, −[c]ₓ, …) with the CoM c in the base frame.
    M, minus_com = jacobians.M_unactuated, jacobians.J_com[:, 3:6]
    rows: np.ndarray = M[3:] + minus_com @ M[:3]
    return rows


def _height(height: float) -> float:
    """The height of the CoM over a sole [m], never that of a fallen robot."""
    return max(float(height), LEAST_COM_HEIGHT)


def _cross(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """a × b of two vectors (3,), much faster than numpy's function on vectors of this size."""
    a_x, a_y, a_z = a.tolist()
    b_x, b_y, b_z = b.tolist()
    return a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x
