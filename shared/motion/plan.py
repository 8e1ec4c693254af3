"""The motion of a configured task."""

from __future__ import annotations

from collections.abc import Callable

from shared.config.settings import RunConfig
from shared.motion.standing import Standing
from shared.motion.walking import Walking
from shared.robots import Robot
from shared.wbc.reference import Motion

MakeMotion = Callable[[Robot, RunConfig], Motion]


def make_motion(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion from which both ends of the link derive the reference.

    Raise `ConfigError` if the motion is not possible.
    """
    if config.task == "walk":
        return Walking(robot, config.walk)
    return Standing(robot)
