"""The catalogue of robots. To add a robot, add an entry; no other module names a robot.

`docs/another-robot.md` says where to read off each number of an entry.
"""

from __future__ import annotations

from typing import Any

from shared.errors import ConfigError, one_of
from shared.robots.description import Foot, FootDescription, Robot, RobotDescription

# Sole of Romeo without the toe, which this URDF welds to the foot and which no contact uses.
# The rectangle was read off the collision mesh of the ankle-roll body, mirrored for the right foot.
_ROMEO_SOLE_X = (-0.0735, 0.120)
_ROMEO_SOLE_INNER, _ROMEO_SOLE_OUTER = 0.0526, 0.0674

# Sole of Talos: section of the collision mesh ankle_X_collision.stl 1 mm above its lowest point,
# because its edges are rounded. Its two sides differ by 4 mm; both have the smaller value here. The
# height is that of the URDF's left_sole_link.
_TALOS_SOLE_X = (-0.105, 0.094)
_TALOS_SOLE_Y = (-0.058, 0.058)
_TALOS_SOLE_HEIGHT = 0.107

_TALOS_SETTINGS: dict[str, Any] = {
    # The push needs three quarters of the URDF's effort limits.
    "robot": {"torque_clamp": 1.0},
    "wbc": {
        # Romeo's 1e-5 over the square of the ratio of their masses, because N² are weighed against
        # (m/s²)². With 1e-5, evenly shared forces count nearly as much as the CoM, and Talos leans.
        "weights": {"force": 2e-6},
        # Half of the value with which it falls. With 30, and LA at 25 ms, a foot rolls from edge to
        # edge when it lands or the push unloads it.
        "gains": {"contact_damping": 15.0},
    },
}

CATALOGUE: dict[str, RobotDescription] = {
    "romeo": RobotDescription(
        name="romeo",
        urdf="romeo_description/urdf/romeo_small.urdf",
        srdf="romeo_description/srdf/romeo_small.srdf",
        posture="half_sitting",
        feet=(
            FootDescription(
                side=Foot.LEFT,
                joint="LAnkleRoll",
                sole_height=0.0684,
                sole_x=_ROMEO_SOLE_X,
                sole_y=(-_ROMEO_SOLE_INNER, _ROMEO_SOLE_OUTER),
            ),
            FootDescription(
                side=Foot.RIGHT,
                joint="RAnkleRoll",
                sole_height=0.0684,
                sole_x=_ROMEO_SOLE_X,
                sole_y=(-_ROMEO_SOLE_OUTER, _ROMEO_SOLE_INNER),
            ),
        ),
        leg_radii=(0.071, 0.054),
    ),
    "talos": RobotDescription(
        name="talos",
        urdf="talos_data/robots/talos_reduced.urdf",
        srdf="talos_data/srdf/talos.srdf",
        posture="half_sitting",
        feet=(
            FootDescription(
                side=Foot.LEFT,
                joint="leg_left_6_joint",
                sole_height=_TALOS_SOLE_HEIGHT,
                sole_x=_TALOS_SOLE_X,
                sole_y=_TALOS_SOLE_Y,
            ),
            FootDescription(
                side=Foot.RIGHT,
                joint="leg_right_6_joint",
                sole_height=_TALOS_SOLE_HEIGHT,
                sole_x=_TALOS_SOLE_X,
                sole_y=_TALOS_SOLE_Y,
            ),
        ),
        leg_radii=(0.079, 0.071),
        settings={
            # Romeo's 100 N times the ratio of their masses.
            "balance": {**_TALOS_SETTINGS, "push": ["223N@1.0s:0.2s:+y"]},
            "walk": {**_TALOS_SETTINGS, "walk": {"step_length": 0.15}},
        },
    ),
}


def description_of(name: str) -> RobotDescription:
    """Return the entry of a robot; raise `ConfigError` with the known ones if there is none."""
    if name not in CATALOGUE:
        raise ConfigError(f"robot: {one_of(CATALOGUE, name)}")
    return CATALOGUE[name]


def load_robot(name: str) -> Robot:
    """Load a robot by its catalogue name; raise `ConfigError` if the catalogue lacks it."""
    # Imported here: a process that needs only a robot's settings, as the shim, loads no Pinocchio.
    from shared.robots.loading import load

    return load(description_of(name))
