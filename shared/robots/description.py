"""The data that the controller and the simulated plant need about a robot, beside its URDF.

`RobotDescription` is plain data, an entry of the catalogue. `Robot` is that entry loaded: the
Pinocchio model with sole frames added, a standing configuration with the soles on the ground, and
the actuators' limits. Looking up an entry, as the settings do, loads no Pinocchio.
"""

from __future__ import annotations

import enum
import importlib.metadata
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pinocchio as pin


class Foot(str, enum.Enum):
    """A foot by its side."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True)
class FootDescription:
    """One foot: the joint that carries it and the rectangle of its sole that may touch the ground.

    The sole frame has the axes of the joint's frame, x forward and y left, and its origin
    `sole_height` below the joint [m]. The rectangle is given in that frame [m].
    """

    side: Foot
    joint: str
    sole_height: float
    sole_x: tuple[float, float]
    sole_y: tuple[float, float]

    def corners(self, margin: float = 0.0) -> np.ndarray:
        """Corners of the sole rectangle shrunk by `margin` [m], in the sole frame, shape (4, 3)."""
        (x0, x1), (y0, y1) = self.sole_x, self.sole_y
        return np.array(
            [[x, y, 0.0] for x in (x0 + margin, x1 - margin) for y in (y0 + margin, y1 - margin)]
        )


@dataclass(frozen=True)
class RobotDescription:
    """A catalogue entry. Paths are relative to the robots folder of example-robot-data.

    `posture` names the SRDF's group state in which the robot stands. `leg_radii` are the distances
    of the inner side of the thigh and of the shank from the lines between the joints [m].
    `settings` has, for each task, the defaults that this robot changes, by the keys of a settings
    file. A file and flags come on top.
    """

    name: str
    urdf: str
    srdf: str
    posture: str
    feet: tuple[FootDescription, FootDescription]
    leg_radii: tuple[float, float]
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Robot:
    """A loaded robot. `q_standing` (nq,) in Pinocchio's order, `mass` [kg].

    Limits of the joints as the URDF has them: `effort_limit` (nv − 6,) [N m], `velocity_limit`
    (nv − 6,) [rad/s], `position_limit` (2, nv − 6) lower and upper [rad].
    """

    description: RobotDescription
    model: pin.Model
    q_standing: np.ndarray
    effort_limit: np.ndarray
    velocity_limit: np.ndarray
    position_limit: np.ndarray
    mass: float
    urdf_path: Path

    @property
    def name(self) -> str:
        return self.description.name


def robots_folder() -> Path:
    """Folder of the installed robot data (package `example-robot-data`)."""
    distribution = importlib.metadata.distribution("example-robot-data")
    return Path(str(distribution.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def sole_frame_name(side: Foot) -> str:
    """Name of the sole frame that `load` adds to the Pinocchio model."""
    return f"{side.value}_sole_frame"
