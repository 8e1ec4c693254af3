"""The data that the controller and the simulated plant need about a robot, beside its URDF.

A `RobotDescription` is the content of a robot file: see `shared/robots/robot_file.py`. A `Robot` is
loaded from it: the Pinocchio model with sole frames added, a standing configuration with the soles
on the ground, and the actuators' limits. Descriptions are read without Pinocchio and numpy.
"""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import pinocchio as pin


# Acceleration of gravity [m/s²], of every model and plant.
GRAVITY = 9.81


class Foot(str, enum.Enum):
    """A foot by its side."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True)
class Sole:
    """The rectangle of a sole that may touch the ground, in the sole frame [m].

    The sole frame has x forward, y left and z up when the robot stands, and z = 0 on the ground.
    """

    side: Foot
    x: tuple[float, float]
    y: tuple[float, float]

    def corners(self, margin: float = 0.0) -> np.ndarray:
        """Corners of the rectangle shrunk by `margin` [m], shape (4, 3)."""
        import numpy as np

        (x0, x1), (y0, y1) = self.x, self.y
        return np.array(
            [[x, y, 0.0] for x in (x0 + margin, x1 - margin) for y in (y0 + margin, y1 - margin)]
        )


@dataclass(frozen=True)
class FootDescription:
    """One foot: the joint or frame of the URDF that carries it, and its sole frame in that one.

    `translation` [m] and `rotation`, roll, pitch and yaw [rad] as in a URDF, place the sole frame.
    `sole` None takes the rectangle, and the height, from the URDF's collision geometry.
    """

    side: Foot
    sole: Sole | None
    joint: str = ""
    frame: str = ""
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Posture:
    """The posture in which a robot stands.

    It is a group state of the SRDF, or `angles` of joints [rad], 0 for the others, with the base
    turned by roll, pitch and yaw [rad].
    """

    state: str = ""
    angles: Mapping[str, float] = field(default_factory=dict)
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RobotDescription:
    """The content of a robot file. `name` is that of the file.

    `packages` are folders in which `package://` is looked up. `leg_radii` are the distances of the
    inner side of the thigh and of the shank from the lines between the joints [m]. `settings` has,
    for each task, the defaults that this robot changes, by the keys of a settings file. A file and
    flags come on top. `stated` is a text of all that the file states, without places of files.
    """

    name: str
    urdf: Path
    srdf: Path | None
    packages: tuple[Path, ...]
    posture: Posture
    feet: tuple[FootDescription, FootDescription]
    leg_radii: tuple[float, float] | None = None
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    stated: str = ""

    @property
    def digest(self) -> str:
        """A digest of the content of the robot file, the URDF and the SRDF, wherever they lie.

        With a sole from collision shapes it covers their meshes.
        """
        digest = hashlib.sha256(self.stated.encode())
        for path in (self.urdf, self.srdf, *self._meshes_of_soles()):
            digest.update(path.read_bytes() if path is not None and path.is_file() else b"")
        return digest.hexdigest()[:16]

    def _meshes_of_soles(self) -> Iterator[Path | None]:
        """The collision meshes, if a sole is read off them."""
        if any(foot.sole is None for foot in self.feet):
            # Imported here: most descriptions have no meshes to look for.
            from shared.robots.meshes import mesh_files

            what = f"robot {self.name}: urdf"
            for _, _, path in mesh_files(self.urdf, self.packages, kind="collision", what=what):
                yield path


@dataclass(frozen=True)
class Robot:
    """A loaded robot. `q_standing` (nq,) in Pinocchio's order, `mass` [kg].

    Limits of the joints as the URDF has them: `effort_limit` (nv − 6,) [N m], `velocity_limit`
    (nv − 6,) [rad/s], `position_limit` (2, nv − 6) lower and upper [rad].
    """

    description: RobotDescription
    model: pin.Model
    soles: tuple[Sole, Sole]
    q_standing: np.ndarray
    effort_limit: np.ndarray
    velocity_limit: np.ndarray
    position_limit: np.ndarray
    mass: float

    @property
    def name(self) -> str:
        return self.description.name

    def sole_frame(self, side: Foot) -> pin.Frame:
        """The frame of a sole: `parentJoint`, the joint that carries it, and `placement` on it."""
        return self.model.frames[self.model.getFrameId(sole_frame_name(side))]


def data_folder() -> Path:
    """Folder of the installed robot data, in which `package://example-robot-data` lies."""
    # Imported here: it takes longer to load than a description.
    from importlib.metadata import distribution

    return Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share")))


def sole_frame_name(side: Foot) -> str:
    """Name of the sole frame that `load` adds to the Pinocchio model."""
    return f"{side.value}_sole_frame"
