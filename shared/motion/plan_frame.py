"""The plan's frame: the frame in which both ends derive references, and its place in the world.

World from plan is a turn about the vertical and a displacement. They are zero until the plan
follows the feet, after a long joint hold or a drift (`robot_node/plan_anchor.py`). The robot
expresses its state in the plan's frame before it sends or uses it, so that the edge needs no field
for it. Velocities are in the base frame and do not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shared.wbc.reference import turned


@dataclass(frozen=True)
class PlanFrame:
    """World from plan: position `x`, `y`, `z` [m], and heading `yaw` [rad].

    A joint hold leaves the height `z` as it is.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    z: float = 0.0

    def in_plan(self, q: np.ndarray) -> np.ndarray:
        """Return a configuration (nq,) of the world in the plan's frame."""
        if self == _AT_THE_ORIGIN:
            return q
        q = q.copy()
        q[:3] = turned(-self.yaw).dot(q[:3] - (self.x, self.y, self.z))
        q[3:7] = _turned_quaternion(q[3:7], -self.yaw)
        return q

    def in_world(self, q: np.ndarray) -> np.ndarray:
        """Return a configuration (nq,) of the plan in the world."""
        if self == _AT_THE_ORIGIN:
            return q
        q = q.copy()
        q[:3] = self.point_in_world(q[:3])
        q[3:7] = _turned_quaternion(q[3:7], self.yaw)
        return q

    def point_in_world(self, point: np.ndarray) -> np.ndarray:
        """Return a point (3,) of the plan in the world [m]."""
        if self == _AT_THE_ORIGIN:
            return point
        moved: np.ndarray = turned(self.yaw).dot(point) + np.array((self.x, self.y, self.z))
        return moved

    def followed_by(self, frame: PlanFrame) -> PlanFrame:
        """Return the frame in the world that is `frame` in the plan."""
        x, y, z = self.point_in_world(np.array((frame.x, frame.y, frame.z))).tolist()
        return PlanFrame(x, y, math.remainder(self.yaw + frame.yaw, math.tau), z)

    @staticmethod
    def between(in_world: PlanFrame, in_plan: PlanFrame) -> PlanFrame:
        """Return the frame in which a pose `in_world` has the pose `in_plan`."""
        yaw = in_world.yaw - in_plan.yaw
        x, y, _ = turned(yaw).dot((in_plan.x, in_plan.y, 0.0)).tolist()
        return PlanFrame(
            in_world.x - x,
            in_world.y - y,
            math.remainder(yaw, math.tau),
            in_world.z - in_plan.z,
        )


_AT_THE_ORIGIN = PlanFrame()


def _turned_quaternion(quat_xyzw: np.ndarray, yaw: float) -> np.ndarray:
    """Return a rotation (4,) followed by a turn about the vertical."""
    s, c = math.sin(yaw / 2), math.cos(yaw / 2)
    x, y, z, w = quat_xyzw.tolist()
    return np.array((c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z))
