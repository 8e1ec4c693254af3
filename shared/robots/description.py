"""What the controller and the simulated plant must know of a robot, beside its URDF.

`RobotDescription` is plain data, an entry of the catalogue. `Robot` is that entry loaded: the
Pinocchio model with sole frames added, a standing configuration with the soles on the ground, and
the actuators' limits.
"""

from __future__ import annotations

import enum
import importlib.metadata
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

# Smallest second moment of mass of a body [kg m²]: MuJoCo refuses bodies whose principal moments of
# inertia violate the triangle inequality, and some published URDFs have such bodies.
MIN_SECOND_MOMENT = 1e-7


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
    """A catalogue entry. Paths are relative to the robots folder of example-robot-data."""

    name: str
    urdf: str
    srdf: str
    posture: str
    feet: tuple[FootDescription, FootDescription]


@dataclass(frozen=True)
class Robot:
    """A loaded robot. `q_standing` (nq,) in Pinocchio's order, `effort_limit` (nv − 6,) [N m]."""

    description: RobotDescription
    model: pin.Model
    q_standing: np.ndarray
    effort_limit: np.ndarray
    urdf_path: Path

    @property
    def name(self) -> str:
        return self.description.name

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return float(pin.computeTotalMass(self.model))


def robots_folder() -> Path:
    """Folder of the installed robot data (package `example-robot-data`)."""
    distribution = importlib.metadata.distribution("example-robot-data")
    return Path(str(distribution.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def sole_frame_name(side: Foot) -> str:
    """Name of the sole frame that `load` adds to the Pinocchio model."""
    return f"{side.value}_sole_frame"


def load(description: RobotDescription) -> Robot:
    """Load a catalogue entry: model, sole frames, repaired inertias, standing configuration."""
    folder = robots_folder()
    urdf_path = folder / description.urdf
    model = pin.buildModelFromUrdf(str(urdf_path), pin.JointModelFreeFlyer())
    pin.loadReferenceConfigurations(model, str(folder / description.srdf), False)
    for index in range(1, model.njoints):
        model.inertias[index] = _repaired(model.inertias[index])
    for foot in description.feet:
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, -foot.sole_height]))
        joint = model.getJointId(foot.joint)
        frame = pin.Frame(sole_frame_name(foot.side), joint, 0, placement, pin.FrameType.OP_FRAME)
        model.addFrame(frame)
    q_standing = np.array(model.referenceConfigurations[description.posture])
    return Robot(
        description=description,
        model=model,
        q_standing=_on_the_ground(model, q_standing),
        effort_limit=np.array(model.effortLimit[6:]),
        urdf_path=urdf_path,
    )


def _repaired(inertia: pin.Inertia) -> pin.Inertia:
    """Body inertia with its second moments of mass clamped from below; exact where none is."""
    moments, axes = np.linalg.eigh(inertia.inertia)
    second_moments = 0.5 * moments.sum() - moments
    if second_moments.min() >= MIN_SECOND_MOMENT:
        return inertia
    second_moments = np.maximum(second_moments, MIN_SECOND_MOMENT)
    moments = second_moments.sum() - second_moments
    return pin.Inertia(inertia.mass, inertia.lever, axes @ np.diag(moments) @ axes.T)


def _on_the_ground(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """`q` with the base lifted so that the lowest sole is at z = 0 and the base above x = y = 0."""
    data = model.createData()
    q = q.copy()
    q[:3] = 0.0
    pin.framesForwardKinematics(model, data, q)
    heights = [data.oMf[model.getFrameId(sole_frame_name(side))].translation[2] for side in Foot]
    q[2] = -min(heights)
    return q
