"""Rigid-body terms of the robot at a state: the cheap ones of b and the expensive ones of A.

`kinematics` and `inverse_dynamics` cost the robot a few recursive passes. Only the edge computes
`jacobians`. Frames are Pinocchio's: base velocity and acceleration in the base frame, sole
quantities in the sole frame, the centre of mass in the world frame.

Copying the results out of Pinocchio costs as much as those passes. The terms that the robot needs
each millisecond therefore stay in Pinocchio's memory: they are `Live`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NewType

import numpy as np
import pinocchio as pin

from shared.robots import Foot, Robot
from shared.robots.description import sole_frame_name

# An array in the workspace of a model, which overwrites it in its next call of any kind.
# Use it at once; compute lasting values from it or copy it.
Live = NewType("Live", np.ndarray)


class _Held:
    """The memory of an array together with its owner, for numpy."""

    def __init__(self, array: np.ndarray, owner: object) -> None:
        self.__array_interface__ = array.__array_interface__
        self.owner = owner


def live(array: np.ndarray, owner: object) -> Live:
    """Return a view of an array in the memory of `owner`, which lives as long as the view.

    Pinocchio's own views of an element of a vector do not keep the vector alive.
    """
    return Live(np.asarray(_Held(array, owner)))


@dataclass(slots=True)
class Kinematics:
    """Terms of b at (q, v); and, at a solution (a, f), those of the residual b − M (a, f).

    `q` (nq,), `v` (nv,); `a` (nv,), None for zero; `force` (nv,) M a + h − J_cᵀ w of Eq. (1a)
    [N, N m], which for b is h; `com`, `com_velocity`, `com_acceleration` (3,) in the world;
    `world_from_base` (3, 3); `sole_velocity`, `sole_acceleration` (6,) per foot, linear then
    angular, in the sole frame. Accelerations are J a + J̇ v, for b the drifts J̇ v.

    A model has one, which each of its calls overwrites, in part or as a whole: see `Live`.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray | None
    force: Live
    com: Live
    com_velocity: Live
    com_acceleration: Live
    world_from_base: Live
    sole_velocity: dict[Foot, Live]
    sole_acceleration: dict[Foot, Live]
    soles: dict[Foot, _Sole]
    momenta: _Momenta

    def sole_placement(self, foot: Foot) -> pin.SE3:
        """World from sole."""
        return self.soles[foot].placement()

    def angular_momentum(self) -> tuple[Live, Live]:
        """About the CoM [kg m²/s] and its rate at the acceleration [N m], (3,) in the world.

        Computed here, by one more pass, because most robots have no such task.
        """
        return self.momenta.at(self.q, self.v, self.a)


@dataclass(slots=True)
class Jacobians:
    """Configuration-dependent terms of A.

    `M_unactuated` (6, nv) and `M_actuated` (nv − 6, nv): base and joint rows of the inertia matrix;
    `J_sole` (6, nv) per foot, in the sole frame; `J_com` (3, nv) in the base frame. None depends on
    where the base is or how it is turned.
    """

    M_unactuated: np.ndarray
    M_actuated: np.ndarray
    J_sole: dict[Foot, np.ndarray]
    J_com: np.ndarray


@dataclass(slots=True)
class RowMultipliers:
    """One number per row of the QP, for products with the transposed rows.

    `dynamics` (6,) of M_u, `com` (3,) of J_com, `soles` (6,) per foot of J_sole, in their frames;
    `joints` (nv,) of rows that are the identity; `angular_momentum` (3,) about the CoM, in the base
    frame, None without such rows.
    """

    dynamics: np.ndarray
    com: np.ndarray
    soles: dict[Foot, np.ndarray]
    joints: np.ndarray
    angular_momentum: np.ndarray | None = None

    @staticmethod
    def zero(nv: int) -> RowMultipliers:
        return RowMultipliers(np.zeros(6), np.zeros(3), {}, np.zeros(nv))

    def add_angular_momentum(self, rows: np.ndarray) -> None:
        """Add multipliers (3,) of the rows of the angular momentum."""
        given = self.angular_momentum
        self.angular_momentum = rows if given is None else given + rows


class _Momenta:
    """The centroidal momentum and its rate, in the workspace of a model."""

    def __init__(self, model: pin.Model, data: pin.Data) -> None:
        self._model, self._data = model, data
        self._still = np.zeros(model.nv)

    def at(self, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> tuple[Live, Live]:
        """The angular momentum about the CoM and its rate, (3,) in the world."""
        data = self._data
        pin.computeCentroidalMomentumTimeVariation(
            self._model, data, q, v, self._still if a is None else a
        )
        return Live(data.hg.angular), Live(data.dhg.angular)


class _Sole:
    """A sole frame on the joint that carries it: from live motions of the joint to its own."""

    def __init__(
        self, model: pin.Model, data: pin.Data, forces: pin.StdVec_Force, foot: Foot
    ) -> None:
        # `world_from_joint` is in its memory.
        self._data = data
        self.frame = model.getFrameId(sole_frame_name(foot))
        self.joint_from_sole = model.frames[self.frame].placement
        self.origin_in_joint = self.joint_from_sole.translation
        joint = model.frames[self.frame].parentJoint
        self.world_from_joint = data.oMi[joint]
        self._sole_from_joint = np.ascontiguousarray(self.joint_from_sole.toActionMatrixInverse())
        self._joint_from_wrench = np.ascontiguousarray(self.joint_from_sole.toDualActionMatrix())
        self._velocity = live(data.v[joint].vector, data)
        self._acceleration = live(data.a[joint].vector, data)
        self._force = live(forces[joint].vector, forces)

    def placement(self) -> pin.SE3:
        """World from sole."""
        return self.world_from_joint * self.joint_from_sole

    def velocity(self, out: np.ndarray | None = None) -> np.ndarray:
        """(6,) in the sole frame."""
        return self._sole_from_joint.dot(self._velocity, out)

    def acceleration(self, out: np.ndarray | None = None) -> np.ndarray:
        """(6,) in the sole frame."""
        return self._sole_from_joint.dot(self._acceleration, out)

    def load(self, wrench: np.ndarray) -> None:
        """Put a wrench (6,) in the sole frame into the external forces."""
        self._joint_from_wrench.dot(wrench, self._force)

    def unload(self) -> None:
        self._force.fill(0.0)


class WholeBodyModel:
    """Pinocchio model and workspace of one robot. Not shared between threads."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = robot.model
        self.data = data = robot.model.createData()
        self.nq, self.nv = robot.model.nq, robot.model.nv
        self._mass = pin.computeTotalMass(self.model)
        self._weightless = self.model.copy()
        self._weightless.gravity = pin.Motion.Zero()
        self._no_acceleration = np.zeros(self.nv)
        self._external_forces = pin.StdVec_Force()
        for _ in range(self.model.njoints):
            self._external_forces.append(pin.Force.Zero())
        self._soles = {}
        for foot in Foot:
            self._soles[foot] = _Sole(self.model, data, self._external_forces, foot)
        self._bias_force = live(data.nle, data)
        self._generalised_force = live(data.tau, data)
        self._now = Kinematics(
            q=robot.q_standing,
            v=self._no_acceleration,
            a=None,
            force=self._bias_force,
            com=live(data.com[0], data),
            com_velocity=live(data.vcom[0], data),
            com_acceleration=live(data.acom[0], data),
            world_from_base=live(data.oMi[1].rotation, data),
            sole_velocity={foot: Live(np.zeros(6)) for foot in Foot},
            sole_acceleration={foot: Live(np.zeros(6)) for foot in Foot},
            soles=self._soles,
            momenta=_Momenta(self.model, data),
        )

    def kinematics(
        self,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray | None = None,
        wrenches: dict[Foot, np.ndarray] | None = None,
    ) -> Kinematics:
        """Terms of b at (q, v); with accelerations `a` and contact `wrenches`, of its residual."""
        now = self._now
        now.q, now.v, now.a = q, v, a
        if a is None or wrenches is None:
            pin.nonLinearEffects(self.model, self.data, q, v)
            now.force = self._bias_force
            pin.centerOfMass(self.model, self.data, q, v, self._no_acceleration, False)
        else:
            now.force = self.inverse_dynamics(q, v, a, wrenches)
            pin.centerOfMass(self.model, self.data, q, v, a, False)
        for foot, sole in self._soles.items():
            sole.velocity(now.sole_velocity[foot])
            sole.acceleration(now.sole_acceleration[foot])
        return now

    def jacobians(self, q: np.ndarray) -> Jacobians:
        """Terms of A at q."""
        model, data = self.model, self.data
        M = pin.crba(model, data, q)
        M_unactuated, M_actuated = M[:6].copy(), M[6:].copy()
        J_sole = {
            foot: pin.computeFrameJacobian(model, data, q, sole.frame, pin.LOCAL)
            for foot, sole in self._soles.items()
        }
        # The base rows of M map v to the momentum in the base frame; its first part is m ċ.
        return Jacobians(M_unactuated, M_actuated, J_sole, J_com=M_unactuated[:3] / self._mass)

    def sole_motion(
        self, foot: Foot, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """J v and J a + J̇ v of a sole, (6,) each in the sole frame, without forming J."""
        pin.forwardKinematics(self.model, self.data, q, v, a)
        sole = self._soles[foot]
        return sole.velocity(), sole.acceleration()

    def inverse_dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, wrenches: dict[Foot, np.ndarray]
    ) -> Live:
        """Generalised force M a + h − Jᵀ w at (q, v), shape (nv,), Eq. (1a).

        `wrenches` holds the contact wrench (6,) on each loaded foot, in its sole frame. The first
        six entries are the dynamics residual of the floating base.
        """
        self._load_soles(wrenches)
        pin.rnea(self.model, self.data, q, v, a, self._external_forces)
        return self._generalised_force

    def _load_soles(self, wrenches: dict[Foot, np.ndarray]) -> None:
        """Set the external forces of the next inverse dynamics, (6,) per foot in its sole frame."""
        for foot, sole in self._soles.items():
            wrench = wrenches.get(foot)
            if wrench is None:
                sole.unload()
            else:
                sole.load(wrench)

    def transposed(self, q: np.ndarray, multipliers: RowMultipliers) -> np.ndarray:
        """M_uᵀ μ + J_comᵀ μ + Σ J_soleᵀ μ + μ at q, shape (nv,), by one pass without forming a row.

        The base columns of M are what an acceleration of the base alone asks of all joints.
        """
        a = np.zeros(self.nv)
        a[:6] = multipliers.dynamics
        turn = multipliers.angular_momentum
        if turn is not None:
            # M_u of the moment about the CoM c: μ at the base's origin, and c × μ.
            com = pin.centerOfMass(self.model, self.data, q, False)
            in_base = self.data.oMi[1].actInv(com)
            a[3:6] += turn
            a[:3] += np.cross(in_base, turn)
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
        base_from_sole = world_from_base.actInv(now.sole_placement(foot))
        moved: np.ndarray = base_from_sole.actInv(pin.Motion(motion)).vector
        return moved

    def com_and_soles(self, q: np.ndarray) -> tuple[np.ndarray, dict[Foot, np.ndarray]]:
        """Centre of mass and origin of each sole frame in the world, (3,), at q."""
        com = pin.centerOfMass(self.model, self.data, q, False).copy()
        soles = {
            foot: sole.world_from_joint.act(sole.origin_in_joint)
            for foot, sole in self._soles.items()
        }
        return com, soles

    def sole_placements(self, q: np.ndarray) -> dict[Foot, pin.SE3]:
        """World placement of each sole frame at q."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return {foot: self.data.oMf[sole.frame].copy() for foot, sole in self._soles.items()}
