"""The tasks: one class each, with its Jacobian for the edge and its feedback for both ends.

`target` is s̈* − J̇ v of Eq. (6), with s̈* = s̈_ref + kp (s_ref − s) + kd (ṡ_ref − ṡ) and
kd = 2 √kp (critical damping). The row weight √ω is applied by the stack.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from shared.motion.reference import Reference
from shared.robots import Foot
from shared.wbc.model import Jacobians, Kinematics


class Task(Protocol):
    """A linear objective ‖J a − target‖² with weight ω."""

    @property
    def name(self) -> str: ...
    @property
    def size(self) -> int: ...
    @property
    def weight(self) -> float: ...

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        """J, shape (size, nv)."""
        ...

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        """s̈* − J̇ v, shape (size,)."""
        ...


@dataclass(frozen=True)
class ComTask:
    """Centre of mass, world frame [m]."""

    weight: float
    kp: float
    name: str = "com"
    size: int = 3

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return jacobians.J_com

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        kd = 2.0 * math.sqrt(self.kp)
        return (
            reference.com_acceleration
            + self.kp * (reference.com - kinematics.com)
            + kd * (reference.com_velocity - kinematics.com_velocity)
            - kinematics.com_drift
        )


class BaseOrientationTask:
    """Orientation of the base, error in the base frame [rad]."""

    name = "base_orientation"
    size = 3

    def __init__(self, *, weight: float, kp: float, nv: int) -> None:
        self.weight = weight
        self.kp = kp
        self._jacobian = np.eye(nv)[3:6]

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return self._jacobian

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        base_from_reference = kinematics.world_from_base.T @ reference.world_from_base
        kd = 2.0 * math.sqrt(self.kp)
        return self.kp * pin.log3(base_from_reference) - kd * kinematics.v[3:6]


class PostureTask:
    """Joint positions [rad]."""

    name = "posture"

    def __init__(self, *, weight: float, kp: float, nv: int) -> None:
        self.weight = weight
        self.kp = kp
        self.size = nv - 6
        self._jacobian = np.eye(nv)[6:]

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return self._jacobian

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        kd = 2.0 * math.sqrt(self.kp)
        return self.kp * (reference.posture - kinematics.q[7:]) - kd * kinematics.v[6:]


class SwingFootTask:
    """Pose of the swing foot, in its sole frame: position [m], then orientation [rad]."""

    name = "swing_foot"
    size = 6

    def __init__(self, *, weight: float, kp: float, foot: Foot) -> None:
        self.weight = weight
        self.kp = kp
        self.foot = foot

    def jacobian(self, jacobians: Jacobians) -> np.ndarray:
        return jacobians.J_sole[self.foot]

    def target(self, kinematics: Kinematics, reference: Reference) -> np.ndarray:
        swing = reference.swing
        if swing is None:  # the plan has this foot on the ground: keep it where it is
            return -kinematics.sole_drift[self.foot]
        kd = 2.0 * math.sqrt(self.kp)
        placement = kinematics.sole_placement[self.foot]
        R = placement.rotation
        v, omega = np.split(kinematics.sole_velocity[self.foot], 2)
        reference_rotation = pin.utils.rotate("z", swing.yaw)
        linear = R.T @ (
            swing.acceleration
            + self.kp * (swing.position - placement.translation)
            + kd * swing.velocity
        )
        # The rows hold spatial accelerations: a point's acceleration less ω × v.
        linear -= kd * v + np.cross(omega, v)
        upright = R.T[:, 2]
        angular = (
            self.kp * pin.log3(R.T @ reference_rotation)
            + kd * (swing.yaw_rate * upright - omega)
            + swing.yaw_acceleration * upright
        )
        return np.concatenate([linear, angular]) - kinematics.sole_drift[self.foot]
