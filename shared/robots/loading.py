"""Load a robot's model from its description with Pinocchio.

Every robot passes `CHECKS`: those of its URDF before Pinocchio reads it, the others as it stands.
`./wbc robot check` shows all faults of a robot, `load` refuses it with the first one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin

from shared.errors import ConfigError, did_you_mean, one_of
from shared.robots import standing, urdf
from shared.robots.description import (
    Foot,
    FootDescription,
    Robot,
    RobotDescription,
    sole_frame_name,
)
from shared.robots.srdf import read_state
from shared.robots.urdf import Urdf, read_urdf

# Smallest second moment of mass of a body [kg m²]: MuJoCo refuses bodies whose principal moments of
# inertia violate the triangle inequality, and some published URDFs have such bodies.
MIN_SECOND_MOMENT = 1e-7
_ROOT = "root_joint"
_QUATERNION_ERROR = 1e-3

URDF_CHECKS: dict[str, Callable[[Urdf], Iterator[str]]] = {
    "finite numbers": urdf.numbers,
    "one tree without loops": urdf.one_tree,
    "hinges with a range, none of which mimics another": urdf.hinges,
    "finite positive limits of effort and velocity": urdf.efforts,
    "positive masses": urdf.masses,
}
STANDING_CHECKS: dict[str, Callable[[Robot], Iterator[str]]] = {
    "posture within the joints' ranges": standing.posture_in_range,
    "sole frames with x forward and z up, level": standing.sole_axes,
    "one left and one right foot, on their sides": standing.feet_on_their_sides,
    "soles of a foot's size, apart": standing.sole_sizes,
    "soles below everything, at one height": standing.soles_below,
    "centre of mass above the feet": standing.over_the_feet,
    "legs bent, so that steps are in reach": standing.bent_legs,
    "torques of standing within the effort limits": standing.torque_margin,
}


def load(description: RobotDescription) -> Robot:
    """Load a robot; raise `ConfigError` with the first fault of its files."""
    tree = _read(description)
    for of_urdf in URDF_CHECKS.values():
        _refuse(description, of_urdf(tree))
    robot = _load(description)
    for of_robot in STANDING_CHECKS.values():
        _refuse(description, of_robot(robot))
    return robot


def checks(description: RobotDescription) -> Iterator[tuple[str, list[str]]]:
    """Yield the name of each check with all faults that it finds.

    Checks of the standing robot follow only if the URDF has no fault. Raise `ConfigError` if a file
    cannot be read, or names something that is not there.
    """
    tree = _read(description)
    sound = True
    for name, of_urdf in URDF_CHECKS.items():
        faults = list(of_urdf(tree))
        sound &= not faults
        yield name, faults
    if sound:
        robot = _load(description)
        for name, of_robot in STANDING_CHECKS.items():
            yield name, list(of_robot(robot))


def _read(description: RobotDescription) -> Urdf:
    return read_urdf(description.urdf, what=f"robot {description.name}: urdf")


def _refuse(description: RobotDescription, faults: Iterator[str]) -> None:
    for fault in faults:
        raise ConfigError(f"robot {description.name}: {fault}")


def _load(description: RobotDescription) -> Robot:
    what = f"robot {description.name}"
    try:
        model = pin.buildModelFromUrdf(str(description.urdf), pin.JointModelFreeFlyer())
    except (ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"{what}: expected a URDF that Pinocchio reads, got: {reason}") from None
    q_standing = _posture(description, model, what=what)
    for index in range(1, model.njoints):
        model.inertias[index] = _repaired(model.inertias[index])
    soles = []
    for foot in description.feet:
        joint, placement = _carrier(foot, model, what=what)
        sole = foot.sole
        if sole is None:
            from shared.robots.collision_sole import collision_sole

            sole, height = collision_sole(description, model, foot.side, joint, placement)
            placement = placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        model.addFrame(
            pin.Frame(sole_frame_name(foot.side), joint, 0, placement, pin.FrameType.OP_FRAME)
        )
        soles.append(sole)
    return Robot(
        description=description,
        model=model,
        soles=(soles[0], soles[1]),
        q_standing=_on_the_ground(model, q_standing),
        effort_limit=np.array(model.effortLimit[6:]),
        velocity_limit=np.array(model.velocityLimit[6:]),
        position_limit=np.stack([model.lowerPositionLimit[7:], model.upperPositionLimit[7:]]),
        mass=float(pin.computeTotalMass(model)),
    )


def _posture(description: RobotDescription, model: pin.Model, *, what: str) -> np.ndarray:
    """The configuration (nq,) of a description's posture, with the base anywhere."""
    posture = description.posture
    if posture.state:
        return _state_of_srdf(description, model, what=what)
    q = np.array(pin.neutral(model))
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(*posture.base)).coeffs()
    joints = list(model.names)[2:]
    for name, angle in posture.angles.items():
        if name not in joints:
            raise ConfigError(f"{what}: posture.angles: {one_of(joints, name)}")
        q[model.joints[model.getJointId(name)].idx_q] = angle
    return q


def _state_of_srdf(description: RobotDescription, model: pin.Model, *, what: str) -> np.ndarray:
    """The configuration (nq,) of a state of the SRDF. It may name joints that the URDF lacks."""
    assert description.srdf is not None
    name = description.posture.state
    state = read_state(description.srdf, name, what=what)
    where = f"{what}: posture.state {name}"
    q = np.array(pin.neutral(model))
    for index in range(1, model.njoints):
        joint, values = model.joints[index], state.get(model.names[index])
        if values is None:
            continue
        if len(values) != joint.nq:
            raise ConfigError(
                f"{where}: expected {joint.nq} numbers for joint {model.names[index]}, got "
                f"{len(values)}; correct it in {description.srdf}"
            )
        q[joint.idx_q : joint.idx_q + joint.nq] = values
    absent = [each for each in list(model.names)[2:] if each not in state]
    for unknown in sorted(state.keys() - set(model.names)):
        if meant := did_you_mean(absent, unknown):
            raise ConfigError(f"{where}: expected a joint of the URDF, got {unknown!r}{meant}")
    length = float(np.linalg.norm(q[3:7]))
    if abs(length - 1.0) > _QUATERNION_ERROR:
        raise ConfigError(
            f"{where}: expected a unit quaternion of the base, got one of length {length:.3g}; "
            f"correct {_ROOT} in {description.srdf}"
        )
    return q


def _carrier(foot: FootDescription, model: pin.Model, *, what: str) -> tuple[int, pin.SE3]:
    """The joint that carries a foot, and the placement of its sole frame on it."""
    rotation = pin.rpy.rpyToMatrix(*foot.rotation) if any(foot.rotation) else np.eye(3)
    placement = pin.SE3(rotation, np.array(foot.translation))
    if foot.joint:
        joints = list(model.names)[2:]
        if foot.joint not in joints:
            raise ConfigError(f"{what}: feet.{foot.side.value}.joint: {one_of(joints, foot.joint)}")
        return model.getJointId(foot.joint), placement
    frames = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
    if foot.frame not in frames:
        raise ConfigError(f"{what}: feet.{foot.side.value}.frame: {one_of(frames, foot.frame)}")
    frame = model.frames[model.getFrameId(foot.frame, pin.FrameType.BODY)]
    return frame.parentJoint, frame.placement * placement


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
