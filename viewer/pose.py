"""The geometry of the scene in the world frame, from one row of the robot's telemetry.

    contact point p = world_from_sole · corner,    contact force = R_world_from_sole · f
    friction used = max(|f_x|, |f_y|) / μ f_z,     centre of pressure = Σ p F_z / Σ F_z

The support polygon is the convex hull of the loaded soles' contact points, laid on the ground.
All forces are the controller's commands. This module draws nothing and does no I/O.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from shared.motion.ground import FLAT, Ground
from shared.robots import Foot, Robot
from shared.robots.description import sole_frame_name
from shared.wbc.balance import convex_hull
from shared.wbc.contacts import CORNER_MARGIN, POINTS_PER_FOOT, ContactMode

# At a point that carries less, the direction of the force means nothing [N].
CARRYING = 5.0
_PYRAMID = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])


@dataclass(frozen=True)
class Placements:
    """Joints in the world: `translation` (n, 3) [m], `quat_xyzw` (n, 4)."""

    translation: np.ndarray
    quat_xyzw: np.ndarray


@dataclass(frozen=True)
class Frame:
    """The scene at one instant, in the world frame.

    `joints` are those of the `PoseModel`. `contact_points` (k, 3) [m] and `contact_forces` (k, 3)
    [N] have k = 4 for each loaded foot. `friction_edges` (k, 4, 3) [N] are the edges of each
    point's friction pyramid up to its normal force. `friction_used` (k,) is 1 on the pyramid, and 0
    in its middle and at points without a load. `centre_of_pressure` (3,) is on the ground, NaN
    without forces. `support_polygon` (m + 1, 3) [m] is closed: its first point is repeated at the
    end.
    """

    joints: Placements
    contact_points: np.ndarray
    contact_forces: np.ndarray
    friction_edges: np.ndarray
    friction_used: np.ndarray
    centre_of_pressure: np.ndarray
    support_polygon: np.ndarray


class PoseModel:
    """The forward kinematics of one robot for the scene. Not shared between threads.

    `friction` is the μ that the robot's controller assumes.
    """

    def __init__(
        self, robot: Robot, joints: Sequence[int], *, friction: float, ground: Ground = FLAT
    ) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self._joints = tuple(joints)
        self._friction = friction
        self._ground = ground
        self._soles = {foot: robot.model.getFrameId(sole_frame_name(foot)) for foot in Foot}
        self._corners = {sole.side: sole.corners(CORNER_MARGIN) for sole in robot.soles}

    def joints(self, q: np.ndarray) -> Placements:
        """Return the placements of the joints at q (nq,)."""
        pin.framesForwardKinematics(self._model, self._data, q)
        placements = np.array([pin.SE3ToXYZQUAT(self._data.oMi[joint]) for joint in self._joints])
        return Placements(placements[:, :3], placements[:, 3:])

    def frame(self, q: np.ndarray, f: np.ndarray, mode: ContactMode) -> Frame:
        """Return the scene at q (nq,) with the point forces f (24,) [N] in the sole frames."""
        joints = self.joints(q)
        points, forces, edges, used = [], [], [], []
        for k, foot in zip(mode.feet_indices, mode.feet, strict=True):
            world_from_sole = self._data.oMf[self._soles[foot]]
            rotation = world_from_sole.rotation
            points.append(self._corners[foot] @ rotation.T + world_from_sole.translation)
            in_sole = f.reshape(-1, 3)[k * POINTS_PER_FOOT : (k + 1) * POINTS_PER_FOOT]
            forces.append(in_sole @ rotation.T)
            pyramid = _PYRAMID * [self._friction, self._friction, 1.0] @ rotation.T
            edges.append(np.maximum(in_sole[:, 2], 0.0)[:, None, None] * pyramid)
            used.append(self._friction_used(in_sole))
        contact_points, contact_forces = np.vstack(points), np.vstack(forces)
        return Frame(
            joints=joints,
            contact_points=contact_points,
            contact_forces=contact_forces,
            friction_edges=np.vstack(edges),
            friction_used=np.concatenate(used),
            centre_of_pressure=self._centre_of_pressure(contact_points, contact_forces[:, 2]),
            support_polygon=on_the_ground(closed_hull(contact_points[:, :2]), self._ground),
        )

    def _friction_used(self, forces: np.ndarray) -> np.ndarray:
        """Return the used part of the friction for forces (n, 3) in a sole frame; 0 if small."""
        tangential = np.abs(forces[:, :2]).max(axis=1)
        allowed = self._friction * np.maximum(forces[:, 2], 0.0)
        carrying = np.linalg.norm(forces, axis=1) > CARRYING
        return np.where(carrying, tangential / np.maximum(allowed, 1e-9), 0.0)

    def _centre_of_pressure(self, points: np.ndarray, normal: np.ndarray) -> np.ndarray:
        total = normal.sum()
        if total < CARRYING:
            return np.full(3, np.nan)
        centre: np.ndarray = on_the_ground((normal @ points / total)[None], self._ground)[0]
        return centre


def on_the_ground(points: np.ndarray, ground: Ground) -> np.ndarray:
    """Return points (n, 2 or 3) moved along z to the ground, shape (n, 3)."""
    return np.column_stack([points[:, :2], ground.heights(points)])


def closed_hull(points: np.ndarray) -> np.ndarray:
    """Return the convex hull of points (n, 2), counter-clockwise, with its first corner again."""
    hull = convex_hull(points)
    return np.array([*hull, hull[0]])
