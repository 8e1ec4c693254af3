"""A MuJoCo model generated from the Pinocchio tree, so that both have the same dynamics.

It has one body per joint with its full inertia, a free joint for the base, hinges and motors for
the other joints, one box per sole, and a floor. MuJoCo does not read the URDF itself, because it
refuses COLLADA meshes and some of the published inertias.
"""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from shared.config.settings import PlantConfig
from shared.robots import FootDescription, Robot

_SOLE_THICKNESS = 0.01


def mjcf(robot: Robot, plant: PlantConfig, *, timestep: float) -> str:
    """MuJoCo XML of the robot on a floor; `timestep` in seconds."""
    root = Xml.Element("mujoco", model=robot.name)
    Xml.SubElement(root, "compiler", angle="radian", balanceinertia="false")
    Xml.SubElement(
        root,
        "option",
        timestep=f"{timestep:.9g}",
        integrator="implicitfast",
        cone="elliptic",
        solver="Newton",
        gravity="0 0 -9.81",
    )
    world = Xml.SubElement(root, "worldbody")
    contact: dict[str, Any] = {
        "friction": f"{plant.friction} 0.005 0.0001",
        "solref": f"{plant.contact_time_constant} {plant.contact_damping_ratio}",
    }
    # The floor meets the soles only: contype/conaffinity bits keep the soles apart.
    Xml.SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        size="0 0 1",
        contype="1",
        conaffinity="2",
        **contact,
    )
    feet = {foot.joint: foot for foot in robot.description.feet}
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
            Xml.SubElement(
                body, "joint", name=name, type="hinge", axis=_numbers(_axis(model, joint))
            )
        inertia = model.inertias[joint]
        I = inertia.inertia  # noqa: E741
        Xml.SubElement(
            body,
            "inertial",
            pos=_numbers(inertia.lever),
            mass=repr(float(inertia.mass)),
            fullinertia=_numbers([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]),
        )
        if name in feet:
            body.append(_sole(feet[name], contact))
    actuators = Xml.SubElement(root, "actuator")
    for joint in range(2, model.njoints):
        Xml.SubElement(actuators, "motor", name=model.names[joint], joint=model.names[joint])
    return Xml.tostring(root, encoding="unicode")


def _sole(foot: FootDescription, contact: dict[str, Any]) -> Xml.Element:
    (x0, x1), (y0, y1) = foot.sole_x, foot.sole_y
    centre = [(x0 + x1) / 2, (y0 + y1) / 2, -foot.sole_height + _SOLE_THICKNESS / 2]
    half = [(x1 - x0) / 2, (y1 - y0) / 2, _SOLE_THICKNESS / 2]
    return Xml.Element(
        "geom",
        name=f"{foot.side.value}_sole",
        type="box",
        pos=_numbers(centre),
        size=_numbers(half),
        contype="2",
        conaffinity="1",
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
