"""The robots that are known by name. To add one, add an entry; nothing else names a robot."""

from __future__ import annotations

from shared.errors import ConfigError
from shared.robots.description import Foot, FootDescription, Robot, RobotDescription, load

# Sole of Romeo without the toe, which this URDF welds to the foot and which no contact uses.
# The rectangle was read off the collision mesh of the ankle-roll body, mirrored for the right foot.
_ROMEO_SOLE_X = (-0.0735, 0.120)
_ROMEO_SOLE_INNER, _ROMEO_SOLE_OUTER = 0.0526, 0.0674

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
    ),
}


def load_robot(name: str) -> Robot:
    """Load a robot by its catalogue name; `ConfigError` names the known ones."""
    if name not in CATALOGUE:
        raise ConfigError(f"robot: expected one of {', '.join(CATALOGUE)}, got {name!r}")
    return load(CATALOGUE[name])
