"""Rigid-body terms of the robot at a state: the cheap ones of b and the expensive ones of A.

`kinematics` and `inverse_dynamics` cost the robot a few recursive passes; `jacobians` is what only
the edge computes. Frames are Pinocchio's: base velocity and acceleration in the base frame, sole
quantities in the sole frame, the centre of mass in the world frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from shared.robots import Foot, Robot
from shared.robots.description import sole_frame_name


@dataclass(slots=True)
class Kinematics:
    """State-dependent terms of b. Drifts are accelerations at zero generalised acceleration.

    `q` (nq,), `v` (nv,); `h` (nv,) bias force of Eq. (1a) [N, N m]; `com`, `com_velocity`,
    `com_drift` (3,) in the world; `world_from_base` (3, 3); `sole_velocity`, `sole_drift` (6,) per
    foot, linear then angular, in the sole frame; `sole_placement` world from sole.
    """

    q: np.ndarray
    v: np.ndarray
    h: np.ndarray
    com: np.ndarray
    com_velocity: np.ndarray
    com_drift: np.ndarray
    world_from_base: np.ndarray
    sole_velocity: dict[Foot, np.ndarray]
    sole_drift: dict[Foot, np.ndarray]
    sole_placement: dict[Foot, pin.SE3]


@dataclass(slots=True)
class Jacobians:
    """Configuration-dependent terms of A.

    `M_unactuated` (6, nv): base rows of the inertia matrix; `J_sole` (6, nv) per foot, in the sole
    frame; `J_com` (3, nv) in the world frame.
    """

    M_unactuated: np.ndarray
    J_sole: dict[Foot, np.ndarray]
    J_com: np.ndarray


class WholeBodyModel:
    """Pinocchio model and workspace of one robot. Not shared between threads."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = robot.model
        self.data = robot.model.createData()
        self.nq, self.nv = robot.model.nq, robot.model.nv
        self._no_acceleration = np.zeros(self.nv)
        self._soles = {foot: self.model.getFrameId(sole_frame_name(foot)) for foot in Foot}
        self._sole_joints = {
            foot: self.model.frames[frame].parentJoint for foot, frame in self._soles.items()
        }
        self._sole_placements = {
            foot: self.model.frames[frame].placement for foot, frame in self._soles.items()
        }
        self._external_forces = pin.StdVec_Force()
        for _ in range(self.model.njoints):
            self._external_forces.append(pin.Force.Zero())

    def kinematics(self, q: np.ndarray, v: np.ndarray) -> Kinematics:
        """Terms of b at (q, v)."""
        model, data = self.model, self.data
        h = pin.nonLinearEffects(model, data, q, v).copy()
        pin.centerOfMass(model, data, q, v, self._no_acceleration, False)
        sole_velocity, sole_drift, sole_placement = {}, {}, {}
        for foot, frame in self._soles.items():
            sole_velocity[foot] = pin.getFrameVelocity(model, data, frame, pin.LOCAL).vector
            sole_placement[foot] = data.oMi[self._sole_joints[foot]] * self._sole_placements[foot]
            sole_drift[foot] = pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
        return Kinematics(
            q=q,
            v=v,
            h=h,
            com=data.com[0].copy(),
            com_velocity=data.vcom[0].copy(),
            com_drift=data.acom[0].copy(),
            world_from_base=data.oMi[1].rotation.copy(),
            sole_velocity=sole_velocity,
            sole_drift=sole_drift,
            sole_placement=sole_placement,
        )

    def jacobians(self, q: np.ndarray) -> Jacobians:
        """Terms of A at q."""
        model, data = self.model, self.data
        M = pin.crba(model, data, q)
        pin.computeJointJacobians(model, data, q)
        J_sole = {
            foot: pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            for foot, frame in self._soles.items()
        }
        J_com = pin.jacobianCenterOfMass(model, data, False).copy()
        return Jacobians(M_unactuated=M[:6].copy(), J_sole=J_sole, J_com=J_com)

    def sole_acceleration(
        self, foot: Foot, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> np.ndarray:
        """J a + J̇ v of a sole, (6,) in the sole frame, without forming J."""
        pin.forwardKinematics(self.model, self.data, q, v, a)
        return pin.getFrameAcceleration(self.model, self.data, self._soles[foot], pin.LOCAL).vector

    def inverse_dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, wrenches: dict[Foot, np.ndarray]
    ) -> np.ndarray:
        """Generalised force M a + h − Jᵀ w at (q, v), shape (nv,), Eq. (1a).

        `wrenches` holds the contact wrench (6,) on each loaded foot, in its sole frame. The first
        six entries are the dynamics residual of the floating base.
        """
        for foot, joint in self._sole_joints.items():
            wrench = wrenches.get(foot)
            self._external_forces[joint] = (
                self._sole_placements[foot].act(pin.Force(wrench))
                if wrench is not None
                else pin.Force.Zero()
            )
        return pin.rnea(self.model, self.data, q, v, a, self._external_forces)

    def com_and_soles(self, q: np.ndarray) -> tuple[np.ndarray, dict[Foot, np.ndarray]]:
        """Centre of mass and origin of each sole frame in the world, (3,), at q."""
        com = pin.centerOfMass(self.model, self.data, q, False).copy()
        soles = {
            foot: self.data.oMi[joint].act(self._sole_placements[foot].translation)
            for foot, joint in self._sole_joints.items()
        }
        return com, soles

    def sole_placements(self, q: np.ndarray) -> dict[Foot, pin.SE3]:
        """World placement of each sole frame at q."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return {foot: self.data.oMf[frame].copy() for foot, frame in self._soles.items()}
