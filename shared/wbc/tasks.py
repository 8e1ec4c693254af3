"""The tasks: one class each, with its Jacobian for the edge and its feedback for both ends.

`target` is s̈* − J̇ v of Eq. (6), or s̈* − J̇ v − J a with kinematics at an acceleration a, where
s̈* = s̈_ref + kp (s_ref − s) + kd (ṡ_ref − ṡ) and kd = 2 √kp (critical
damping). The row weight √ω is applied by the stack.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from shared.robots import Foot
from shared.wbc.model import Jacobians, Kinematics, RowMultipliers
from shared.wbc.reference import Reference


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
        """Whether J is the same at every configuration."""
        ...

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        """J, shape (size, nv)."""
        ...

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        """s̈* − J̇ v − J a, shape (size,); a is that of the kinematics, zero for b."""
        ...

    def add_transposed(self, rows: np.ndarray, multipliers: RowMultipliers) -> None:
        """Add Jᵀ `rows` (size,) to a product, as multipliers of the rows that J is made of."""
        ...


@dataclass(frozen=True)
class ComTask:
    """Centre of mass [m], in the base frame: its rows do not change when the robot turns."""

    weight: float
    kp: float
    name: str = "com"
    size: int = 3
    constant: bool = False

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return jacobians.J_com

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        kd = 2.0 * math.sqrt(self.kp)
        target: np.ndarray = kinematics.world_from_base.T @ (
            reference.com_acceleration
            + self.kp * (reference.com - kinematics.com)
            + kd * (reference.com_velocity - kinematics.com_velocity)
            - kinematics.com_acceleration
        )
        return target

    def add_transposed(self, rows: np.ndarray, multipliers: RowMultipliers) -> None:
        multipliers.com += rows


class BaseOrientationTask:
    """Orientation of the base, error in the base frame [rad]."""

    name = "base_orientation"
    size = 3
    constant = True

    def __init__(self, *, weight: float, kp: float, nv: int) -> None:
        self.weight = weight
        self.kp = kp
        self._jacobian = np.eye(nv)[3:6]

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return self._jacobian

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        base_from_reference = kinematics.world_from_base.T @ reference.world_from_base
        kd = 2.0 * math.sqrt(self.kp)
        error = self.kp * pin.log3(base_from_reference)
        target: np.ndarray = error - kd * kinematics.v[3:6] - kinematics.a[3:6]
        return target

    def add_transposed(self, rows: np.ndarray, multipliers: RowMultipliers) -> None:
        multipliers.joints[3:6] += rows


class PostureTask:
    """Joint positions [rad]."""

    name = "posture"
    constant = True

    def __init__(self, *, weight: float, kp: float, nv: int) -> None:
        self.weight = weight
        self.kp = kp
        self.size = nv - 6
        self._jacobian = np.eye(nv)[6:]

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return self._jacobian

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        kd = 2.0 * math.sqrt(self.kp)
        error = self.kp * (reference.posture - kinematics.q[7:])
        target: np.ndarray = error - kd * kinematics.v[6:] - kinematics.a[6:]
        return target

    def add_transposed(self, rows: np.ndarray, multipliers: RowMultipliers) -> None:
        multipliers.joints[6:] += rows


class SwingFootTask:
    """Pose of the swing foot, in its sole frame: position [m], then orientation [rad]."""

    name = "swing_foot"
    size = 6
    constant = False

    def __init__(self, *, weight: float, kp: float, foot: Foot) -> None:
        self.weight = weight
        self.kp = kp
        self.foot = foot

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return jacobians.J_sole[self.foot]

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        swing = reference.swing
        if swing is None:  # the plan has this foot on the ground: keep it where it is
            return -kinematics.sole_acceleration[self.foot]
        kd = 2.0 * math.sqrt(self.kp)
        placement = kinematics.sole_placement[self.foot]
        R = placement.rotation
        velocity = kinematics.sole_velocity[self.foot]
        v, omega = velocity[:3], velocity[3:]
        reference_rotation = pin.utils.rotate("z", swing.yaw)
        target = np.empty(self.size)
        target[:3] = R.T @ (
            swing.acceleration
            + self.kp * (swing.position - placement.translation)
            + kd * swing.velocity
        )
        # The rows hold spatial accelerations: a point's acceleration less ω × v.
        target[:3] -= kd * v + _cross(omega, v)
        upright = R.T[:, 2]
        target[3:] = (
            self.kp * pin.log3(R.T @ reference_rotation)
            + kd * (swing.yaw_rate * upright - omega)
            + swing.yaw_acceleration * upright
        )
        target -= kinematics.sole_acceleration[self.foot]
        return target

    def add_transposed(self, rows: np.ndarray, multipliers: RowMultipliers) -> None:
        multipliers.soles[self.foot] = multipliers.soles.get(self.foot, 0.0) + rows


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b of two vectors (3,); numpy's own takes as long as the whole rest of a target."""
    a_x, a_y, a_z = a.tolist()
    b_x, b_y, b_z = b.tolist()
    return np.array([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x])
