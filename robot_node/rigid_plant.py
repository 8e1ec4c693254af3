"""The simulated robot on ideal rigid contacts: both soles welded to the floor.

The accelerations solve Eq. (1), M a + h = Sᵀτ + J_cᵀ f and J_c a + J̇_c v = 0, with six rows per
foot; Pinocchio's constrained dynamics eliminates f. The welds hold both ways, so a sole neither
slips nor tips nor lifts off: there is no friction cone and no walking. Such a robot falls by
folding up where its torques cannot carry its posture any more.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.config.robot_settings import PlantConfig
from shared.robots import Foot, Robot
from shared.robots.description import sole_frame_name

# The drift of a sole from integration is pulled back as by a critically damped spring (Baumgarte)
# of this time constant [s]: J_c a + J̇_c v = −2/T ė − e/T², zero on the weld itself.
WELD_TIME_CONSTANT = 0.005

# Two stretched legs make the rows of J_c dependent: forces are then the limit of regularised ones.
# Elsewhere the iteration ends after two or three steps at the solution without regularisation.
_REGULARISATION = 1e-10
_ACCURACY = 1e-14
_MAX_ITERATIONS = 10


class RigidPlant:
    """Constrained forward dynamics of one robot, semi-implicit Euler, in Pinocchio's convention.

    No setting of the plant applies to it.
    """

    def __init__(
        self, robot: Robot, config: PlantConfig | None = None, *, timestep: float = 1e-3
    ) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self._lever = robot.model.inertias[1].lever
        self._timestep = timestep
        self._settings = pin.ProximalSettings(_ACCURACY, _REGULARISATION, _MAX_ITERATIONS)
        self.set_state(robot.q_standing, np.zeros(robot.model.nv))

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the robot at (q, v) and weld its soles at their placements in that state.

        A velocity of the soles is damped out, as drift is.
        """
        self._q, self._v = q.copy(), v.copy()
        self._welds = pin.StdVec_RigidConstraintModel()
        self._weld_data = pin.StdVec_RigidConstraintData()
        pin.framesForwardKinematics(self._model, self._data, q)
        for foot in Foot:
            weld = self._weld(foot)
            self._welds.append(weld)
            self._weld_data.append(weld.createData())
        pin.initConstraintDynamics(self._model, self._data, self._welds, self._weld_data)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """True (q, v), shapes (nq,) and (nv,)."""
        return self._q.copy(), self._v.copy()

    def acceleration(self, tau: np.ndarray, *, push: np.ndarray) -> np.ndarray:
        """a (nv,) of Eq. (1) under joint torques (nv − 6,) [N m] and a push, as in `Plant`."""
        force = np.empty(self._model.nv)
        force[:3] = pin.Quaternion(self._q[3:7]).toRotationMatrix().T @ push
        force[3:6] = np.cross(self._lever, force[:3])
        force[6:] = tau
        a: np.ndarray = pin.constraintDynamics(
            self._model,
            self._data,
            self._q,
            self._v,
            force,
            self._welds,
            self._weld_data,
            self._settings,
        )
        return a

    def contact_forces(self) -> dict[Foot, np.ndarray]:
        """Forces of the floor on the soles, as in `Plant`: those of the last step."""
        forces = {}
        for foot, data in zip(Foot, self._weld_data, strict=True):
            # In the frame of the sole, which does not turn.
            forces[foot] = data.oMc1.rotation @ data.contact_force.linear
        return forces

    def step(self, tau: np.ndarray, *, push: np.ndarray) -> None:
        """Advance one timestep under joint torques and a push, as in `Plant`."""
        self._v = self._v + self._timestep * self.acceleration(tau, push=push)
        self._q = pin.integrate(self._model, self._q, self._timestep * self._v)

    def _weld(self, foot: Foot) -> pin.RigidConstraintModel:
        """The constraint that holds a sole at its present placement in the world."""
        index = self._model.getFrameId(sole_frame_name(foot))
        sole = self._model.frames[index]
        weld = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_6D,
            self._model,
            sole.parentJoint,
            sole.placement,
            0,
            self._data.oMf[index],
            pin.LOCAL,
        )
        stiffness, damping = WELD_TIME_CONSTANT**-2, 2.0 / WELD_TIME_CONSTANT
        weld.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(stiffness, damping))
        return weld
