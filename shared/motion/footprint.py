"""A sole on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shared.robots import Foot


@dataclass(frozen=True)
class Footprint:
    """A level sole on the ground: origin of its frame (x, y, z) in the world [m], heading [rad].

    Heights count from the ground on which the robot begins.
    """

    foot: Foot
    x: float
    y: float
    yaw: float
    z: float = 0.0

    @property
    def position(self) -> np.ndarray:
        """(2,) in the world."""
        return np.array([self.x, self.y])

    def to_world(self, point: tuple[float, float]) -> np.ndarray:
        """A point of the sole's plane in the world, seen from above, (2,)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array(
            [self.x + c * point[0] - s * point[1], self.y + s * point[0] + c * point[1]]
        )
