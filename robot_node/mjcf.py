"""A MuJoCo model generated from the Pinocchio tree, so that both have the same dynamics.

It has one body per joint with its full inertia, a free joint for the base, hinges and motors for
the other joints, one box per sole, and the ground. MuJoCo does not read the URDF itself, because it
refuses COLLADA meshes and some of the published inertias.
"""

from __future__ import annotations

import math
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from shared.config.robot_settings import PlantConfig
from shared.errors import ConfigError
from shared.motion.ground import FLAT, HOLE, Ground, Patch
from shared.robots import GRAVITY, Foot, Robot, Sole

_SOLE_THICKNESS = 0.01
# The extent of the ground beyond its patches, and below the deepest hole [m].
_BEYOND, _THICKNESS = 10.0, 0.5


def mjcf(robot: Robot, plant: PlantConfig, *, timestep: float, ground: Ground = FLAT) -> str:
    """MuJoCo XML of the robot on the ground; `timestep` in seconds."""
    root = Xml.Element("mujoco", model=robot.name)
    Xml.SubElement(root, "compiler", angle="radian", balanceinertia="false")
    Xml.SubElement(
        root,
        "option",
        timestep=f"{timestep:.9g}",
        integrator="implicitfast",
        cone="elliptic",
        solver="Newton",
        gravity=f"0 0 {-GRAVITY}",
    )
    world = Xml.SubElement(root, "worldbody")
    contact: dict[str, Any] = {
        "friction": f"{plant.friction} 0.005 0.0001",
        "solref": f"{plant.contact_time_constant} {plant.contact_damping_ratio}",
    }
    # The floor meets the soles only: contype/conaffinity bits keep the soles apart.
    floor = {"contype": "1", "conaffinity": "2", **contact}
    depth = "0 0 0" if ground.flat else _numbers([0.0, 0.0, HOLE])
    Xml.SubElement(world, "geom", name="floor", type="plane", size="0 0 1", pos=depth, **floor)
    for k, patch in enumerate([*ground.patches, *_around(ground)]):
        if patch.z > HOLE:
            Xml.SubElement(world, "geom", {"name": f"ground_{k}", **_block(patch), **floor})
    soles = {robot.sole_frame(sole.side).parentJoint: sole for sole in robot.soles}
    bodies: dict[int, Xml.Element] = {0: world}
    model = robot.model
    for joint in range(1, model.njoints):
        name = model.names[joint]
        placement = model.jointPlacements[joint]
        body = Xml.SubElement(
            bodies[model.parents[joint]],
            "body",
            name=name,
            pos=_numbers(placement.translation),
            quat=_numbers(_wxyz(placement.rotation)),
        )
        bodies[joint] = body
        if joint == 1:
            Xml.SubElement(body, "freejoint", name=name)
        else:
            hinge = {
                "name": name,
                "type": "hinge",
                "axis": _numbers(_axis(model, joint)),
            }
            Xml.SubElement(body, "joint", {**hinge, **_range(robot, plant, joint)})
        inertia = model.inertias[joint]
        I = inertia.inertia  # noqa: E741
        Xml.SubElement(
            body,
            "inertial",
            pos=_numbers(inertia.lever),
            mass=repr(float(inertia.mass)),
            fullinertia=_numbers([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]),
        )
        if joint in soles:
            body.append(_sole(robot, soles[joint], contact, legs_collide=plant.leg_collision))
    if plant.leg_collision:
        for side in Foot:
            for joint, link in _leg(robot, side, contact):
                bodies[joint].append(link)
    actuators = Xml.SubElement(root, "actuator")
    for joint in range(2, model.njoints):
        Xml.SubElement(actuators, "motor", name=model.names[joint], joint=model.names[joint])
    return Xml.tostring(root, encoding="unicode")


def _around(ground: Ground) -> list[Patch]:
    """Level ground on the four sides of the patches."""
    if ground.flat:
        return []
    x0, x1 = min(p.x[0] for p in ground.patches), max(p.x[1] for p in ground.patches)
    y0, y1 = min(p.y[0] for p in ground.patches), max(p.y[1] for p in ground.patches)
    across = (y0 - _BEYOND, y1 + _BEYOND)
    return [
        Patch((x0 - _BEYOND, x0), across, 0.0),
        Patch((x1, x1 + _BEYOND), across, 0.0),
        Patch((x0, x1), (y0 - _BEYOND, y0), 0.0),
        Patch((x0, x1), (y1, y1 + _BEYOND), 0.0),
    ]


def _block(patch: Patch) -> dict[str, str]:
    """The attributes of a box whose upper side is a patch of ground."""
    centre, half, tilt = patch.box((patch.z - HOLE + _THICKNESS) / 2)
    return {
        "type": "box",
        "size": _numbers(half),
        "pos": _numbers(centre),
        "quat": _numbers([math.cos(tilt / 2), 0.0, -math.sin(tilt / 2), 0.0]),
    }


def _range(robot: Robot, plant: PlantConfig, joint: int) -> dict[str, str]:
    """The attributes of a hinge with the position limits of the URDF, if the plant has them."""
    if not plant.joint_limits:
        return {}
    lower, upper = robot.position_limit[:, joint - 2]
    # As stiff as a contact with the floor.
    stop = f"{plant.contact_time_constant} {plant.contact_damping_ratio}"
    return {"limited": "true", "range": _numbers([lower, upper]), "solreflimit": stop}


def _leg(robot: Robot, side: Foot, contact: dict[str, Any]) -> list[tuple[int, Xml.Element]]:
    """Capsules along the thigh and the shank of a leg, each with the joint that carries it."""
    model, radii = robot.model, robot.description.leg_radii
    if radii is None:
        raise ConfigError(
            f"plant.leg_collision: expected a robot file with leg_radii, got that of {robot.name} "
            "without; add them, or try false"
        )
    links: list[tuple[int, np.ndarray]] = []
    joint = robot.sole_frame(side).parentJoint
    # Up the chain to the hip, whose own placement is not along the leg.
    while len(links) < len(radii):
        end = model.jointPlacements[joint].translation
        joint = model.parents[joint]
        if np.linalg.norm(end) > 0.0:
            links.append((joint, end))
    return [
        (
            joint,
            Xml.Element(
                "geom",
                name=f"{side.value}_{name}",
                type="capsule",
                fromto=_numbers([0.0, 0.0, 0.0, *end]),
                size=repr(radius),
                mass="0",
                **_collisions(side),
                **contact,
            ),
        )
        for (joint, end), name, radius in zip(
            reversed(links), ("thigh", "shank"), radii, strict=True
        )
    ]


def _collisions(side: Foot, *, contype: int = 0, conaffinity: int = 0) -> dict[str, Any]:
    """The collision bits with which each leg collides with the other one, but not with itself."""
    own, other = (4, 8) if side is Foot.LEFT else (8, 4)
    return {"contype": str(contype | own), "conaffinity": str(conaffinity | other)}


def _sole(robot: Robot, sole: Sole, contact: dict[str, Any], *, legs_collide: bool) -> Xml.Element:
    # The floor's bits are 1 and 2.
    bits: dict[str, Any] = {"contype": "2", "conaffinity": "1"}
    if legs_collide:
        bits = _collisions(sole.side, contype=2, conaffinity=1)
    (x0, x1), (y0, y1) = sole.x, sole.y
    placement = robot.sole_frame(sole.side).placement
    centre = placement.act(np.array([(x0 + x1) / 2, (y0 + y1) / 2, _SOLE_THICKNESS / 2]))
    if not np.array_equal(placement.rotation, np.eye(3)):
        bits["quat"] = _numbers(_wxyz(placement.rotation))
    half = [(x1 - x0) / 2, (y1 - y0) / 2, _SOLE_THICKNESS / 2]
    return Xml.Element(
        "geom",
        name=f"{sole.side.value}_sole",
        type="box",
        pos=_numbers(centre),
        size=_numbers(half),
        **bits,
        **contact,
    )


def _axis(model: pin.Model, joint: int) -> np.ndarray:
    """Axis of a revolute joint in its own frame, read off its motion subspace."""
    return np.array(model.joints[joint].createData().S).ravel()[3:]


def _wxyz(rotation: np.ndarray) -> np.ndarray:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


def _numbers(values: np.ndarray | list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
