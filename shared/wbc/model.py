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
    """Terms of b at (q, v); and, at a solution (a, f), those of the residual b − M (a, f).

    `q` (nq,), `v`, `a` (nv,); `force` (nv,) M a + h − J_cᵀ w of Eq. (1a) [N, N m], which for b is
    h; `com`, `com_velocity`, `com_acceleration` (3,) in the world; `world_from_base` (3, 3);
    `sole_velocity`, `sole_acceleration` (6,) per foot, linear then angular, in the sole frame;
    `sole_placement` world from sole. Accelerations are J a + J̇ v, for b the drifts J̇ v.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    force: np.ndarray
    com: np.ndarray
    com_velocity: np.ndarray
    com_acceleration: np.ndarray
    world_from_base: np.ndarray
    sole_velocity: dict[Foot, np.ndarray]
    sole_acceleration: dict[Foot, np.ndarray]
    sole_placement: dict[Foot, pin.SE3]


@dataclass(slots=True)
class Jacobians:
    """Configuration-dependent terms of A.

    `M_unactuated` (6, nv): base rows of the inertia matrix; `J_sole` (6, nv) per foot, in the sole
    frame; `J_com` (3, nv) in the base frame. None depends on where the base is or how it is turned.
    """

    M_unactuated: np.ndarray
    J_sole: dict[Foot, np.ndarray]
    J_com: np.ndarray


@dataclass(slots=True)
class RowMultipliers:
    """One number per row of the QP, for products with the transposed rows.

    `dynamics` (6,) of M_u, `com` (3,) of J_com, `soles` (6,) per foot of J_sole, in their frames;
    `joints` (nv,) of rows that are the identity.
    """

    dynamics: np.ndarray
    com: np.ndarray
    soles: dict[Foot, np.ndarray]
    joints: np.ndarray

    @staticmethod
    def zero(nv: int) -> RowMultipliers:
        return RowMultipliers(np.zeros(6), np.zeros(3), {}, np.zeros(nv))


class WholeBodyModel:
    """Pinocchio model and workspace of one robot. Not shared between threads."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = robot.model
        self.data = robot.model.createData()
        self.nq, self.nv = robot.model.nq, robot.model.nv
        self._mass = pin.computeTotalMass(self.model)
        self._weightless = self.model.copy()
        self._weightless.gravity = pin.Motion.Zero()
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

    def kinematics(
        self,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray | None = None,
        wrenches: dict[Foot, np.ndarray] | None = None,
    ) -> Kinematics:
        """Terms of b at (q, v); with accelerations `a` and contact `wrenches`, of its residual."""
        model, data = self.model, self.data
        if a is None or wrenches is None:
            a = self._no_acceleration
            force = pin.nonLinearEffects(model, data, q, v).copy()
        else:
            force = self.inverse_dynamics(q, v, a, wrenches).copy()
        pin.centerOfMass(model, data, q, v, a, False)
        sole_velocity, sole_acceleration, sole_placement = {}, {}, {}
        for foot, frame in self._soles.items():
            sole_velocity[foot] = pin.getFrameVelocity(model, data, frame, pin.LOCAL).vector
            sole_placement[foot] = data.oMi[self._sole_joints[foot]] * self._sole_placements[foot]
            sole_acceleration[foot] = pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
        return Kinematics(
            q=q,
            v=v,
            a=a,
            force=force,
            com=data.com[0].copy(),
            com_velocity=data.vcom[0].copy(),
            com_acceleration=data.acom[0].copy(),
            world_from_base=data.oMi[1].rotation.copy(),
            sole_velocity=sole_velocity,
            sole_acceleration=sole_acceleration,
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
        # The base rows of M map v to the momentum in the base frame; its first part is m ċ.
        return Jacobians(M_unactuated=M[:6].copy(), J_sole=J_sole, J_com=M[:3] / self._mass)

    def sole_motion(
        self, foot: Foot, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """J v and J a + J̇ v of a sole, (6,) each in the sole frame, without forming J."""
        pin.forwardKinematics(self.model, self.data, q, v, a)
        frame = self._soles[foot]
        return (
            pin.getFrameVelocity(self.model, self.data, frame, pin.LOCAL).vector,
            pin.getFrameAcceleration(self.model, self.data, frame, pin.LOCAL).vector,
        )

    def inverse_dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, wrenches: dict[Foot, np.ndarray]
    ) -> np.ndarray:
        """Generalised force M a + h − Jᵀ w at (q, v), shape (nv,), Eq. (1a).

        `wrenches` holds the contact wrench (6,) on each loaded foot, in its sole frame. The first
        six entries are the dynamics residual of the floating base.
        """
        self._load_soles(wrenches)
        force: np.ndarray = pin.rnea(self.model, self.data, q, v, a, self._external_forces)
        return force

    def _load_soles(self, wrenches: dict[Foot, np.ndarray]) -> None:
        """Set the external forces of the next inverse dynamics, (6,) per foot in its sole frame."""
        for foot, joint in self._sole_joints.items():
            wrench = wrenches.get(foot)
            self._external_forces[joint] = (
                self._sole_placements[foot].act(pin.Force(wrench))
                if wrench is not None
                else pin.Force.Zero()
            )

    def transposed(self, q: np.ndarray, multipliers: RowMultipliers) -> np.ndarray:
        """M_uᵀ μ + J_comᵀ μ + Σ J_soleᵀ μ + μ at q, shape (nv,), by one pass without forming a row.

        The base columns of M are what an acceleration of the base alone asks of all joints.
        """
        a = np.zeros(self.nv)
        a[:6] = multipliers.dynamics
        a[:3] += multipliers.com / self._mass
        self._load_soles({foot: -wrench for foot, wrench in multipliers.soles.items()})
        force = pin.rnea(
            self._weightless, self.data, q, self._no_acceleration, a, self._external_forces
        )
        product: np.ndarray = force + multipliers.joints
        return product

    def sole_motion_of_base(self, foot: Foot, now: Kinematics, motion: np.ndarray) -> np.ndarray:
        """The first six columns of J_sole times `motion` (6,): the sole on a rigid body."""
        world_from_base = pin.SE3(now.world_from_base, now.q[:3])
        base_from_sole = world_from_base.actInv(now.sole_placement[foot])
        moved: np.ndarray = base_from_sole.actInv(pin.Motion(motion)).vector
        return moved

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
