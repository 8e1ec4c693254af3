"""Checks of a robot as it stands: the feet, the centre of mass, the reach and the torques."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from shared.robots.description import Foot, Robot

# Part of the stretched leg that a step may use: the rest is needed to lift and land.
REACH_MARGIN = 0.97
# A sole is level within this tilt, and both are of one height within this distance [rad, m].
_TILT, _HEIGHT = 0.02, 0.005
# Least side of a sole, whose contact points are 5 mm inside it [m].
_LEAST_SIDE = 0.02
# A posture may be beyond a joint's range by rounding [rad].
_ROUNDING = 1e-4
# Least horizontal reach of a leg from below its hip [m].
_LEAST_REACH = 0.03


def posture_in_range(robot: Robot) -> Iterator[str]:
    """Yield the joints whose angle in the posture is outside their range."""
    names = list(robot.model.names)[2:]
    for name, angle, lower, upper in zip(
        names, robot.q_standing[7:], *robot.position_limit, strict=True
    ):
        if not lower - _ROUNDING <= angle <= upper + _ROUNDING:
            yield (
                f"expected joint {name} between {lower:.4g} and {upper:.4g} rad in the posture, "
                f"got {angle:.4g}; change the posture or the URDF's limits"
            )


def sole_axes(robot: Robot) -> Iterator[str]:
    """Yield the feet whose sole frame has not z up and x forward."""
    for side, sole in placements(robot).items():
        R = sole.rotation
        rotation = f"feet.{side.value}.rotation = {_suggested(robot, side)}"
        axes = _direction(R[:, 0]), _direction(R[:, 2])
        tilt = math.degrees(math.acos(min(1.0, R[2, 2])))
        if axes != ("forward", "up"):
            yield (
                f"expected a sole frame with x forward and z up, got x {axes[0]} and z {axes[1]} "
                f"at the {side.value} foot; try {rotation}"
            )
        elif math.hypot(R[2, 0], R[2, 1]) > _TILT:
            yield (
                f"expected a level sole, got a tilt of {tilt:.2g}° at the {side.value} foot; "
                f"change the angles of the ankle, or try {rotation}"
            )


def feet_on_their_sides(robot: Robot) -> Iterator[str]:
    """Yield a fault if the left foot is not to the left of the right one, or both are one."""
    left, right = (placements(robot)[side] for side in (Foot.LEFT, Foot.RIGHT))
    if robot.sole_frame(Foot.LEFT).parentJoint == robot.sole_frame(Foot.RIGHT).parentJoint:
        yield "expected two feet, got feet.left and feet.right on one joint; correct one of them"
    elif left.translation[1] <= right.translation[1]:
        yield (
            f"expected the left foot on the left (y), got it at {left.translation[1]:.3f} m and "
            f"the right one at {right.translation[1]:.3f} m; swap feet.left and feet.right, or "
            "turn the base of the posture, so that x is forward"
        )


def sole_sizes(robot: Robot) -> Iterator[str]:
    """Yield a fault if a sole is too small or too large, far from its joint, or over the other."""
    length, _ = leg_length(robot)
    for sole in robot.soles:
        name, frame = f"the {sole.side.value} sole", robot.sole_frame(sole.side)
        for axis, (least, most) in (("x", sole.x), ("y", sole.y)):
            if not _LEAST_SIDE <= most - least <= length:
                yield (
                    f"expected sides between {_LEAST_SIDE:g} m and a leg's length, {length:.2g} m, "
                    f"got {most - least:.3g} m along {axis} at {name}; correct "
                    f"feet.{sole.side.value}.sole, in metres"
                )
        far = float(np.linalg.norm(frame.placement.translation))
        if far > length:
            yield (
                f"expected {name} within a leg's length of its joint, {length:.2g} m, got "
                f"{far:.3g} m; correct feet.{sole.side.value}.translation, in metres"
            )
    at, soles = placements(robot), {sole.side: sole for sole in robot.soles}
    corners = {side: [at[side].act(corner)[1] for corner in soles[side].corners()] for side in Foot}
    overlap = max(corners[Foot.RIGHT]) - min(corners[Foot.LEFT])
    if overlap > 0.0:
        yield (
            f"expected the left sole to the left of the right one, got an overlap of {overlap:.3f} "
            "m in y; correct the soles, or stand wider in the posture"
        )


def soles_below(robot: Robot) -> Iterator[str]:
    """Yield a fault if the soles are not at one height, below all joints."""
    soles = placements(robot)
    heights = {side: float(sole.translation[2]) for side, sole in soles.items()}
    apart = abs(heights[Foot.LEFT] - heights[Foot.RIGHT])
    if apart > _HEIGHT:
        lower = min(heights, key=lambda side: heights[side])
        yield (
            f"expected both soles at one height, got the {lower.value} one {apart:.3f} m lower; "
            "bend both legs alike, or correct the translations of the feet"
        )
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.q_standing)
    for joint in range(1, robot.model.njoints):
        below = float(data.oMi[joint].translation[2])
        if below < 0.0:
            yield (
                f"expected the soles below all joints, got joint {robot.model.names[joint]} "
                f"{-below:.3f} m below them; correct the translations of the feet, or the base of "
                "the posture"
            )


def over_the_feet(robot: Robot) -> Iterator[str]:
    """Yield a fault if the centre of mass is not above the rectangle around both soles."""
    com = pin.centerOfMass(robot.model, robot.model.createData(), robot.q_standing)
    corners = np.vstack(
        [
            [placements(robot)[sole.side].act(corner) for corner in sole.corners()]
            for sole in robot.soles
        ]
    )
    for axis, name in ((0, "x"), (1, "y")):
        least, most = corners[:, axis].min(), corners[:, axis].max()
        if not least < com[axis] < most:
            yield (
                f"expected the centre of mass above the feet, {name} between {least:.3f} and "
                f"{most:.3f} m, got {com[axis]:.3f}; change the posture, or the soles"
            )


def bent_legs(robot: Robot) -> Iterator[str]:
    """Yield a fault if the legs stand stretched, so that no step is in their reach."""
    reach = leg_reach(robot)
    if reach < _LEAST_REACH:
        yield (
            f"expected legs that reach {_LEAST_REACH:g} m or more forward, got {reach:.3f}; bend "
            "hips, knees and ankles in the posture"
        )


def torque_margin(robot: Robot) -> Iterator[str]:
    """Yield the joints that cannot hold the posture with the URDF's effort limits."""
    torques = standing_torques(robot)
    for name, torque, limit in zip(
        list(robot.model.names)[2:], torques, robot.effort_limit, strict=True
    ):
        if abs(torque) >= limit:
            yield (
                f"expected a joint {name} that can hold the posture, got a need of "
                f"{abs(torque):.3g} of {limit:.3g} N m; straighten the posture, or correct its "
                "limit in the URDF"
            )


def placements(robot: Robot) -> dict[Foot, pin.SE3]:
    """World from sole, for each foot, as the robot stands."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.q_standing)
    frames = {side: robot.sole_frame(side) for side in Foot}
    return {side: data.oMi[each.parentJoint] * each.placement for side, each in frames.items()}


def leg_reach(robot: Robot, *, raised: float = 0.0) -> float:
    """Greatest horizontal distance of a foot from below its hip, with the hip `raised` above its
    standing height [m].
    """
    stretched, height = leg_length(robot)
    return math.sqrt(max(0.0, stretched**2 - (height + raised) ** 2))


def leg_length(robot: Robot) -> tuple[float, float]:
    """Length of a leg as far as a step may stretch it, and height of the hip over the ankle in
    standing [m].

    The knee alone stretches a leg. It is the joint with the longest arms to hip and ankle, across
    its axis. Offsets between the joints of a hip stay as they are.
    """
    model = robot.model
    data = model.createData()
    pin.computeJointJacobians(model, data, robot.q_standing)
    ankle = robot.sole_frame(Foot.LEFT).parentJoint
    chain = [joint for joint in model.supports[ankle] if joint > 1]
    hip_at, ankle_at = (data.oMi[joint].translation for joint in (chain[0], ankle))
    shorter, longest = -1.0, 0.0
    for joint in chain[1:-1]:
        axis = data.J[3:, model.joints[joint].idx_v]
        arms = [at - data.oMi[joint].translation for at in (hip_at, ankle_at)]
        along = [float(arm @ axis) for arm in arms]
        across = [float(np.linalg.norm(arm - axis * (arm @ axis))) for arm in arms]
        if min(across) > shorter:
            shorter, longest = min(across), math.hypot(sum(across), along[0] - along[1])
    return longest * REACH_MARGIN, float(hip_at[2] - ankle_at[2])


def standing_torques(robot: Robot) -> np.ndarray:
    """Torques of the joints in the posture (nv − 6,) [N m], with the least wrenches on the soles
    that carry the weight.
    """
    model, data = robot.model, robot.model.createData()
    at_rest = np.zeros(model.nv)
    gravity = pin.rnea(model, data, robot.q_standing, at_rest, at_rest)
    jacobians = np.vstack(
        [
            pin.computeFrameJacobian(
                model, data, robot.q_standing, _frame_id(robot, side), pin.LOCAL
            )
            for side in Foot
        ]
    )
    wrenches = np.linalg.lstsq(jacobians[:, :6].T, gravity[:6], rcond=None)[0]
    torques: np.ndarray = gravity[6:] - jacobians[:, 6:].T.dot(wrenches)
    return torques


def _frame_id(robot: Robot, side: Foot) -> int:
    index: int = robot.model.getFrameId(robot.sole_frame(side).name)
    return index


def _direction(axis: np.ndarray) -> str:
    """The axis of the world nearest to a unit vector, in words."""
    k = int(np.argmax(np.abs(axis)))
    names = (("backward", "forward"), ("right", "left"), ("down", "up"))
    return names[k][int(axis[k] > 0.0)]


def _suggested(robot: Robot, side: Foot) -> str:
    """Roll, pitch and yaw that would align a sole frame with the axes of the world."""
    foot = next(each for each in robot.description.feet if each.side is side)
    written = pin.rpy.rpyToMatrix(*foot.rotation)
    in_world = placements(robot)[side].rotation
    # World from sole is world from carrier, times the present placement in the file.
    carrier = in_world @ written.T
    angles = pin.rpy.matrixToRpy(carrier.T)
    return "[" + ", ".join(f"{angle + 0.0:.5g}" for angle in np.round(angles, 5)) + "]"
