"""Where everything of the scene is, in the world frame, from one row of the robot's telemetry.

    contact point p = world_from_sole · corner,    contact force = R_world_from_sole · f

The support polygon is the convex hull of the loaded soles' contact points, laid on the ground.
Pure: no drawing, no I/O.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from shared.robots import Foot, Robot
from shared.robots.description import sole_frame_name
from shared.wbc.contacts import CORNER_MARGIN, POINTS_PER_FOOT, ContactMode


@dataclass(frozen=True)
class Frame:
    """The scene at one instant, world frame.

    `joint_translation` (n, 3) [m] and `joint_quat_xyzw` (n, 4) of the joints asked for;
    `contact_points` (k, 3) [m] and `contact_forces` (k, 3) [N], k = 4 per loaded foot;
    `support_polygon` (m + 1, 3) [m], closed: its first point is repeated at the end.
    """

    joint_translation: np.ndarray
    joint_quat_xyzw: np.ndarray
    contact_points: np.ndarray
    contact_forces: np.ndarray
    support_polygon: np.ndarray


class PoseModel:
    """Forward kinematics of one robot for the scene. Not shared between threads."""

    def __init__(self, robot: Robot, joints: Sequence[int]) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self._joints = tuple(joints)
        self._soles = {foot: robot.model.getFrameId(sole_frame_name(foot)) for foot in Foot}
        self._corners = {foot.side: foot.corners(CORNER_MARGIN) for foot in robot.description.feet}

    def frame(self, q: np.ndarray, f: np.ndarray, mode: ContactMode) -> Frame:
        """The scene at q (nq,) with the point forces f (24,) [N] in the sole frames."""
        pin.framesForwardKinematics(self._model, self._data, q)
        placements = np.array([pin.SE3ToXYZQUAT(self._data.oMi[joint]) for joint in self._joints])
        points, forces = [], []
        for k, foot in zip(mode.feet_indices, mode.feet, strict=True):
            world_from_sole = self._data.oMf[self._soles[foot]]
            rotation = world_from_sole.rotation
            points.append(self._corners[foot] @ rotation.T + world_from_sole.translation)
            in_sole = f.reshape(-1, 3)[k * POINTS_PER_FOOT : (k + 1) * POINTS_PER_FOOT]
            forces.append(in_sole @ rotation.T)
        contact_points = np.vstack(points)
        return Frame(
            joint_translation=placements[:, :3],
            joint_quat_xyzw=placements[:, 3:],
            contact_points=contact_points,
            contact_forces=np.vstack(forces),
            support_polygon=on_the_ground(convex_hull(contact_points[:, :2])),
        )


def on_the_ground(points: np.ndarray) -> np.ndarray:
    """Points (n, 2 or 3) moved along z to the ground, shape (n, 3)."""
    return np.column_stack([points[:, :2], np.zeros(len(points))])


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Convex hull of points (n, 2), counter-clockwise and closed; Andrew's monotone chain."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    lower = _chain(ordered)
    upper = _chain(ordered[::-1])
    return np.array(lower[:-1] + upper)


def _chain(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that turn left all the way from the first to the last."""
    chain: list[tuple[float, float]] = []
    for point in points:
        while len(chain) >= 2 and _turn(chain[-2], chain[-1], point) <= 0.0:
            chain.pop()
        chain.append(point)
    return chain


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Positive when a → b → c turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
