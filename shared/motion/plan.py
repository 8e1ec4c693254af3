"""The motion of a configured task."""

from __future__ import annotations

from collections.abc import Callable

from shared.config.extensions import TASKS
from shared.config.settings import RunConfig
from shared.extensions import Taken
from shared.motion.standing import Standing
from shared.motion.walking import Walking
from shared.robots import Robot
from shared.wbc.reference import Motion

# The members of a `Motion`, with their arguments.
_MEMBERS = {
    "digest": None,
    "reference": Taken(1),
    "next_switch": Taken(1),
    "stopped": Taken(1),
}

MakeMotion = Callable[[Robot, RunConfig], Motion]


def make_motion(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion from which both ends of the link derive the reference.

    Raise `ConfigError` if the motion is not possible.
    """
    motion: Motion = TASKS.make(config.task, robot, config, members=_MEMBERS)
    # A robot that decides on its steps stands until a plan comes.
    return motion if config.stepping.mode == "off" else Standing(robot)


def standing(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion of the task `balance`."""
    return Standing(robot)


def walking(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion of the task `walk`. Raise `ConfigError` if it cannot be walked."""
    return Walking(robot, config.walk)
