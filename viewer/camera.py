"""The camera's place, by name. Before one robot it follows the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.config.settings import RunConfig
from shared.robots import Robot, load_robot
from viewer.track import SIDE_BY_SIDE

# From the robot towards the camera, x forward and y left.
CAMERAS = {
    "front": (1.95, -0.85, 0.55),
    "side": (0.0, -2.2, 0.35),
    "back": (-1.95, -0.85, 0.55),
    "top": (-0.01, 0.0, 2.2),
}
DEFAULT = "front"
# The height of a humanoid over that of its base, and its width with its arms over its height.
_HEIGHT, _WIDTH = 1.75, 0.6
# The height at which the camera looks, over that of the robot.
_FOCUS = 0.43
# The camera shows at most this part of the way of a walk, to either side of its target [m].
_LOOK_AHEAD = 1.5


def eye_and_target(
    configs: Sequence[RunConfig], *, name: str = DEFAULT
) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's position and target, each (3,) [m, world], for robots side by side.

    The camera shows all robots. For several, it shows the whole way of a walk, or the beginning of
    a long one.
    """
    tallest = max((load_robot(each.robot.name) for each in configs), key=focus_height)
    height = _HEIGHT * float(tallest.q_standing[2])
    width = _WIDTH * height + (len(configs) - 1) * SIDE_BY_SIDE
    several = len(configs) > 1
    ahead = max((_half_way(each) for each in configs), key=abs) if several else 0.0
    distance = max(1.4 * height, 1.35 * width) + 0.9 * abs(ahead)
    towards = np.array(CAMERAS[name])
    towards[1] /= len(configs)
    target = np.array([ahead, 0.0, focus_height(tallest)])
    eye = target + distance * towards / np.linalg.norm(towards) + [0.0, 0.0, abs(ahead)]
    return eye, target


def focus_height(robot: Robot) -> float:
    """Return the height at which the camera looks at a robot [m]."""
    return _FOCUS * _HEIGHT * float(robot.q_standing[2])


def _half_way(config: RunConfig) -> float:
    """Return the distance to the middle of a walk, or of the beginning of a long one [m]."""
    if not config.walks:
        return 0.0
    walk = config.walk
    half = (walk.place.x if config.task == "go" else walk.steps * walk.step_length) / 2
    return max(-_LOOK_AHEAD, min(half, _LOOK_AHEAD))
