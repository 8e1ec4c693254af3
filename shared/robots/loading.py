"""Load a catalogue entry: a Pinocchio model with sole frames, and a standing configuration."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.errors import ConfigError
from shared.robots.description import (
    Foot,
    Robot,
    RobotDescription,
    robots_folder,
    sole_frame_name,
)

# Smallest second moment of mass of a body [kg m²]: MuJoCo refuses bodies whose principal moments of
# inertia violate the triangle inequality, and some published URDFs have such bodies.
MIN_SECOND_MOMENT = 1e-7


def load(description: RobotDescription) -> Robot:
    """Load a catalogue entry; raise `ConfigError` if the robot cannot be used here."""
    folder = robots_folder()
    urdf_path = folder / description.urdf
    model = pin.buildModelFromUrdf(str(urdf_path), pin.JointModelFreeFlyer())
    pin.loadReferenceConfigurations(model, str(folder / description.srdf), False)
    _check(description, model)
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
        velocity_limit=np.array(model.velocityLimit[6:]),
        position_limit=np.stack([model.lowerPositionLimit[7:], model.upperPositionLimit[7:]]),
        mass=float(pin.computeTotalMass(model)),
        urdf_path=urdf_path,
    )


def _check(description: RobotDescription, model: pin.Model) -> None:
    """Check that the names of an entry exist, and that every joint is a hinge with limits."""
    joints, postures = list(model.names), [each.key() for each in model.referenceConfigurations]
    for foot in description.feet:
        if foot.joint not in joints:
            raise ConfigError(
                f"robot {description.name}: expected the joint of the {foot.side.value} foot, one "
                f"of {', '.join(joints[2:])}, got {foot.joint!r}"
            )
    if description.posture not in postures:
        raise ConfigError(
            f"robot {description.name}: expected a posture of the SRDF, one of "
            f"{', '.join(postures)}, got {description.posture!r}"
        )
    for name, joint in zip(joints[2:], model.joints[2:], strict=True):
        if not (joint.nq == 1 and joint.shortname().startswith("JointModelR")):
            raise ConfigError(
                f"robot {description.name}: expected hinges with limits, joint {name} is a "
                f"{joint.shortname()}; try a URDF in which it is fixed"
            )


def _repaired(inertia: pin.Inertia) -> pin.Inertia:
    """Return a body's inertia, with its second moments of mass clamped from below if needed."""
    moments, axes = np.linalg.eigh(inertia.inertia)
    second_moments = 0.5 * moments.sum() - moments
    if second_moments.min() >= MIN_SECOND_MOMENT:
        return inertia
    second_moments = np.maximum(second_moments, MIN_SECOND_MOMENT)
    moments = second_moments.sum() - second_moments
    return pin.Inertia(inertia.mass, inertia.lever, axes @ np.diag(moments) @ axes.T)


def _on_the_ground(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Return `q` with the lowest sole at z = 0 and the base above x = y = 0."""
    data = model.createData()
    q = q.copy()
    q[:3] = 0.0
    pin.framesForwardKinematics(model, data, q)
    heights = [data.oMf[model.getFrameId(sole_frame_name(side))].translation[2] for side in Foot]
    q[2] = -min(heights)
    return q
