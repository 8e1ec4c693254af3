"""The robot at rest over its feet: the lengths that plans of steps need."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from shared.motion.footprint import Footprint
from shared.motion.footsteps import standing_footprints
from shared.robots import GRAVITY, Foot, Robot
from shared.wbc.reference import turned


@dataclass(frozen=True)
class Stance:
    """The standing robot over its feet.

    `com_height` is the CoM's over the soles, lower than in the standing posture by `lowering`, and
    `width` the distance of the sole frames [m].
    `rest` (2,) is the CoM's place from the middle of the sole frames, `cop_in_sole` the middle of a
    sole in its frame.
    """

    com_height: float
    width: float
    rest: tuple[float, float]
    cop_in_sole: tuple[float, float]
    lowering: float

    @staticmethod
    def of(robot: Robot, *, lowering: float = 0.0) -> Stance:
        """The stance of a robot's standing posture, with the CoM lower by `lowering` [m]."""
        com = pin.centerOfMass(robot.model, robot.model.createData(), robot.q_standing)
        feet = standing_footprints(robot)
        x, y, _ = middle(feet)
        left, right = feet[Foot.LEFT], feet[Foot.RIGHT]
        sole_x = robot.soles[0].x
        return Stance(
            com_height=float(com[2]) - lowering,
            width=left.y - right.y,
            rest=(float(com[0]) - x, float(com[1]) - y),
            cop_in_sole=(sum(sole_x) / 2, 0.0),
            lowering=lowering,
        )

    @property
    def omega(self) -> float:
        """ω of the linear inverted pendulum [1/s]."""
        return math.sqrt(GRAVITY / self.com_height)

    def rest_over(self, feet: Mapping[Foot, Footprint]) -> np.ndarray:
        """Return where the CoM rests over feet, (2,)."""
        x, y, yaw = middle(feet)
        rest: np.ndarray = np.array((x, y)) + turned(yaw)[:2, :2] @ self.rest
        return rest

    def level_within_reach(self, feet: Mapping[Foot, Footprint], com: np.ndarray) -> float:
        """Return how high the CoM may be at a place (2,), from its standing height over z = 0 [m].

        It is then no further from any sole than in the standing posture. A straight leg cannot hold
        the trunk upright.
        """
        reach = self.com_height + self.lowering
        rest_x, rest_y = self.rest
        levels = []
        for foot, sole in feet.items():
            half = self.width / 2 if foot is Foot.LEFT else -self.width / 2
            away = min(math.dist(com, sole.to_world((rest_x, rest_y - half))), reach)
            levels.append(sole.z + math.sqrt(reach**2 - away**2) - reach)
        return min(levels)


def lower_foot(feet: Mapping[Foot, Footprint]) -> Footprint:
    """Return the lower footprint, which gives a goal on unknown ground its height.

    An early landing is safe and a late one is not.
    """
    return min(feet.values(), key=lambda each: each.z)


def middle(feet: Mapping[Foot, Footprint]) -> tuple[float, float, float]:
    """The middle between the sole frames, and their mean heading."""
    left, right = feet[Foot.LEFT], feet[Foot.RIGHT]
    yaw = left.yaw + 0.5 * math.remainder(right.yaw - left.yaw, math.tau)
    return (left.x + right.x) / 2, (left.y + right.y) / 2, yaw
