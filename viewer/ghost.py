"""The reference as a robot: a posture that meets the whole plan at once.

The plan gives the CoM, the base's orientation, both soles, and joint angles to stay near. The ghost
is the posture that meets the first three exactly and is nearest to the joint angles. Newton's
method finds it from the ghost before:

    Δq = J⁺ r + (1 − J⁺ J) (posture − q)        r: of CoM, base orientation and both soles

The ghost shows the reference of the tasks, not a state that the robot can reach at once. After a
push, the robot moves back to its ghost.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.motion.footprint import Footprint
from shared.motion.footsteps import standing_footprints
from shared.motion.walking import Walking
from shared.robots import Foot, Robot
from shared.robots.description import sole_frame_name
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Motion, Reference

# The largest error of CoM and soles, too small to be seen [m, rad], and the maximum number of steps
# towards it.
TOLERANCE = 1e-4
MAX_STEPS = 8
# Damping: without it, a stretched leg leads to infinite joint angles.
_DAMPING = 1e-6


class Ghost:
    """Postures of the plan, one after the other. Not shared between threads."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self._frames = {foot: robot.model.getFrameId(sole_frame_name(foot)) for foot in Foot}
        self._motion = motion
        self._stopped = False
        self._soles = {foot: _placed(each) for foot, each in standing_footprints(robot).items()}
        self._q = robot.q_standing.copy()
        self._met: Reference | None = None
        self._heights: dict[Foot, float] = {}

    def stop(self, time_ns: int) -> None:
        """End the walk early from `time_ns` on, as the robot's commands say."""
        if not self._stopped:
            self._motion = self._motion.stopped(time_ns)
            self._stopped = True

    def posture(self, time_ns: int) -> np.ndarray:
        """Return the configuration (nq,) that meets the plan at `time_ns` of the task."""
        reference = self._motion.reference(max(0, time_ns))
        if reference is self._met:
            return self._q
        self._place_soles(reference, time_ns)
        for _ in range(MAX_STEPS):
            if self._step(reference) < TOLERANCE:
                break
        self._met = reference
        return self._q

    def _place_soles(self, reference: Reference, time_ns: int) -> None:
        if isinstance(self._motion, Walking):
            stance = _stance(self._motion, time_ns)
            self._soles = {each.foot: _placed(each) for each in stance}
            self._heights = {each.foot: each.z for each in stance}
        # A walk that ends early has its feet where the last steps left them, on their footprints.
        for foot, sole in self._soles.items():
            sole.translation[2] = self._heights.get(foot, 0.0)
        swing = reference.swing
        if swing is not None:
            (foot,) = (foot for foot in Foot if foot not in reference.mode.feet)
            self._soles[foot] = pin.SE3(pin.utils.rotate("z", swing.yaw), swing.position)

    def _step(self, reference: Reference) -> float:
        """Make one step of Newton's method; return the largest error before it."""
        model, data = self._model, self._data
        J_com = pin.jacobianCenterOfMass(model, data, self._q)
        pin.computeJointJacobians(model, data, self._q)
        pin.updateFramePlacements(model, data)
        residuals = [reference.com - data.com[0]]
        rows = [J_com]
        turn = data.oMi[1].rotation.T @ reference.world_from_base
        residuals.append(pin.log3(turn))
        rows.append(np.eye(3, model.nv, 3))
        for foot, frame in self._frames.items():
            residuals.append(pin.log6(data.oMf[frame].actInv(self._soles[foot])).vector)
            rows.append(pin.getFrameJacobian(model, data, frame, pin.LOCAL))
        r, J = np.concatenate(residuals), np.vstack(rows)
        to_posture = np.append(np.zeros(6), reference.posture - self._q[7:])
        damped = J @ J.T + _DAMPING * np.eye(len(J))
        step = to_posture + J.T @ np.linalg.solve(damped, r - J @ to_posture)
        self._q = pin.integrate(model, self._q, step)
        return float(np.abs(r).max())


def _stance(walk: Walking, time_ns: int) -> tuple[Footprint, Footprint]:
    """Return the planned places of both soles; for the swing foot, its last place."""
    phase = next((each for each in walk.phases if time_ns < each.end_ns), walk.phases[-1])
    step = walk.steps[0] if phase.step is None else phase.step
    landed = phase.step is not None and phase.mode is ContactMode.DOUBLE_SUPPORT
    return step.support, step.goal if landed else step.start


def _placed(footprint: Footprint) -> pin.SE3:
    return pin.SE3(
        pin.utils.rotate("z", footprint.yaw), np.array([footprint.x, footprint.y, footprint.z])
    )
