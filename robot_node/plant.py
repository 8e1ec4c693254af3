"""The robot simulated in MuJoCo: the only file that calls it, and the only one that converts to it.

MuJoCo's free joint has its linear velocity in the world frame and its quaternion scalar-first.
Pinocchio's has the velocity in the base frame and the quaternion scalar-last.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

import mujoco
import numpy as np
import pinocchio as pin

from robot_node.mjcf import mjcf
from shared.config.extensions import PLANTS
from shared.config.robot_settings import PlantConfig
from shared.motion.ground import FLAT, Ground
from shared.robots import Foot, Robot
from shared.user_code import Members, Method, array_fault


class Plant(Protocol):
    """A robot with a known state that advances by one timestep at a call.

    It is made by `NAME(robot, config, timestep=…)`, from a `Robot`, the settings of `[plant]` and
    the timestep [s], and begins in the standing configuration. States are in Pinocchio's convention
    and in the order of the robot's model: q is the base's position in the world and its quaternion
    x, y, z, w, then the joints [rad]; v is the base's linear and angular velocity in the base
    frame, then the joints' [rad/s]. `robot_node/plant_checks.py` has the checks of a plant.
    """

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the robot at (q, v)."""

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """True (q, v), shapes (nq,) and (nv,), in Pinocchio's convention."""

    def contact_forces(self) -> dict[Foot, np.ndarray]:
        """Forces of the ground on the soles (3,), in the world [N]."""

    def step(self, tau: np.ndarray, *, push: np.ndarray) -> None:
        """Advance one timestep under joint torques (nv − 6,) [N m] and a force on the base [N],
        world.

        The force acts at the centre of mass of the base body.
        """


def make_plant(
    robot: Robot, config: PlantConfig, *, timestep: float, ground: Ground = FLAT
) -> Plant:
    """Make the plant that `config.kind` names; `timestep` [s].

    A plant gets its ground as an argument if the ground is not flat. Raise `ConfigError` if it
    cannot be imported, lacks a member, or knows flat ground only.
    """
    terrain = {} if ground.flat else {"ground": ground}
    members: Members = {
        "set_state": Method(2),
        "state": Method(fault=partial(_state_fault, robot)),
        "contact_forces": Method(fault=_forces_fault),
        "step": Method(1, ("push",)),
    }
    plant: Plant = PLANTS.make(
        config.kind, robot, config, members=members, timestep=timestep, **terrain
    )
    return plant


def _state_fault(robot: Robot, state: Any) -> str:
    """Return the fault of the state of a user's plant, or an empty text."""
    if not isinstance(state, tuple) or len(state) != 2:
        return f"expected a pair q, v, got a {type(state).__name__}"
    (q, v), model = state, robot.model
    return array_fault(q, (model.nq,), "q") or array_fault(v, (model.nv,), "v")


def _forces_fault(forces: Any) -> str:
    """Return the fault of the contact forces of a user's plant, or an empty text."""
    if not isinstance(forces, dict) or set(forces) != set(Foot):
        return f"expected a force for each of Foot.LEFT and Foot.RIGHT, got {forces!r:.60}"
    faults = (array_fault(force, (3,), f"that of {foot}") for foot, force in forces.items())
    return next(filter(None, faults), "")


class MujocoPlant:
    """MuJoCo simulation of one robot on the ground.

    States go in and out in Pinocchio's convention.
    """

    def __init__(
        self,
        robot: Robot,
        config: PlantConfig,
        *,
        timestep: float = 1e-3,
        ground: Ground = FLAT,
    ) -> None:
        xml = mjcf(robot, config, timestep=timestep, ground=ground)
        self.model = mujoco.MjModel.from_xml_string(xml)
        # A diverging simulation must be seen as a fall, not silently put back to its start.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        mujoco.set_mju_user_warning(_ignore_warning)
        self.data = mujoco.MjData(self.model)
        # Views of MuJoCo's memory, because each access by name looks them up again.
        self._qpos, self._qvel, self._ctrl = self.data.qpos, self.data.qvel, self.data.ctrl
        self._fastest = robot.velocity_limit if config.velocity_limits else None
        self._force_on_base = self.data.xfrc_applied[self.model.body(robot.model.names[1]).id, :3]
        self._soles = {self.model.geom(f"{foot.value}_sole").id: foot for foot in Foot}
        names = [self.model.geom(k).name for k in range(self.model.ngeom)]
        self._ground = {k for k, name in enumerate(names) if name.startswith(("floor", "ground_"))}
        self.set_state(robot.q_standing, np.zeros(robot.model.nv))

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the robot at (q, v)."""
        mujoco.mj_resetData(self.model, self.data)
        self._qpos[:], self._qvel[:] = to_mujoco(q, v)
        mujoco.mj_forward(self.model, self.data)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """True (q, v), shapes (nq,) and (nv,)."""
        return from_mujoco(self._qpos, self._qvel)

    def contact_forces(self) -> dict[Foot, np.ndarray]:
        """Forces of the ground on the soles, as in `Plant`: those of the last step."""
        forces = {foot: np.zeros(3) for foot in Foot}
        wrench = np.empty(6)
        # Read as arrays: a contact as an object costs many times as much.
        contacts = self.data.contact
        frames = contacts.frame.reshape(-1, 3, 3)
        for k, (ground, sole) in enumerate(contacts.geom.tolist()):
            foot = self._soles.get(sole)
            if foot is None or ground not in self._ground:
                continue
            mujoco.mj_contactForce(self.model, self.data, k, wrench)
            # From the first body on the second, in the contact's frame, whose axes are rows.
            forces[foot] += wrench[:3].dot(frames[k])
        return forces

    def _driven(self, tau: np.ndarray, fastest: np.ndarray) -> np.ndarray:
        """The torques (nv − 6,), each 0 if it would drive its joint beyond its velocity limit."""
        rates = self._qvel[6:]
        return np.where((np.abs(rates) >= fastest) & (tau * rates > 0.0), 0.0, tau)

    def step(self, tau: np.ndarray, *, push: np.ndarray) -> None:
        """Advance one timestep under joint torques and a push, as in `Plant`."""
        self._ctrl[:] = tau if self._fastest is None else self._driven(tau, self._fastest)
        self._force_on_base[:] = push
        mujoco.mj_step(self.model, self.data)


def _ignore_warning(message: str) -> None:
    """Ignore a warning: instability shows in the state, and MuJoCo would write the warning to a
    file.
    """


def to_mujoco(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(q, v) of Pinocchio as (qpos, qvel) of MuJoCo."""
    qpos, qvel = q.copy(), v.copy()
    qpos[3:7] = q[[6, 3, 4, 5]]
    qvel[:3] = world_from_base(q) @ v[:3]
    return qpos, qvel


def from_mujoco(qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(qpos, qvel) of MuJoCo as (q, v) of Pinocchio."""
    q, v = qpos.copy(), qvel.copy()
    q[3:6], q[6] = qpos[4:7], qpos[3]
    world_from_base = np.empty((3, 3))
    mujoco.mju_quat2Mat(world_from_base.ravel(), qpos[3:7])
    # A row times R is Rᵀ times the column.
    qvel[:3].dot(world_from_base, v[:3])
    return q, v


def world_from_base(q: np.ndarray) -> np.ndarray:
    """Rotation of the base, (3, 3), from a Pinocchio configuration."""
    rotation: np.ndarray = pin.Quaternion(q[6], q[3], q[4], q[5]).toRotationMatrix()
    return rotation
