"""The motion of a configured task."""

from __future__ import annotations

import math
from collections.abc import Callable

from shared.config.extensions import TASKS
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.extensions import Taken
from shared.motion.footstep_search import find_footsteps
from shared.motion.ground import make_ground
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


def going(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion of the task `go`. Raise `ConfigError` if no way to the goal is found."""
    ground = make_ground(config.ground, seed=config.seed)
    walk = config.walk
    motion = Walking(robot, walk, steps=find_footsteps(robot, walk, ground, walk.place))
    if config.duration < motion.duration:
        raise ConfigError(
            f"duration: expected at least the {motion.duration:.1f} s of the {len(motion.steps)} "
            f"steps to the goal, got {config.duration:g}; leave it out, or try "
            f"--duration {math.ceil(motion.duration)}s"
        )
    return motion


def walking(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion of the task `walk`. Raise `ConfigError` if it cannot be walked."""
    return Walking(robot, config.walk)
