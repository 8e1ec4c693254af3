"""The motion of a configured task."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from shared.config.extensions import TASKS
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.motion.footstep_search import find_footsteps
from shared.motion.ground import make_ground
from shared.motion.standing import Standing
from shared.motion.walking import Walking
from shared.robots import Robot
from shared.user_code import Attribute, Members, Method, array_fault, kind_fault
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Motion, Reference, SwingState

MakeMotion = Callable[[Robot, RunConfig], Motion]


def make_motion(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion from which both ends of the link derive the reference.

    Raise `ConfigError` if the motion is not possible.
    """
    members: Members = {
        "digest": Attribute(_digest_fault),
        "reference": Method(1, fault=partial(_reference_fault, robot)),
        "next_switch": Method(1, fault=_switch_fault),
        "stopped": Method(1, same_kind=True),
    }
    motion: Motion = TASKS.make(config.task, robot, config, members=members)
    # A robot that decides on its steps stands until a plan comes.
    return motion if config.stepping.mode == "off" else Standing(robot)


def _digest_fault(digest: Any) -> str:
    """Return the fault of the digest of a user's motion, or an empty text."""
    if isinstance(digest, bytes) and len(digest) == 8:
        return ""
    return f"expected eight bytes, got {digest!r:.40}; try motion_digest"


def _switch_fault(switch_ns: Any, time_ns: int) -> str:
    """Return the fault of the next contact switch of a user's motion, or an empty text."""
    if fault := kind_fault(switch_ns, int, or_none=True):
        return fault
    if switch_ns is None or switch_ns > time_ns:
        return ""
    return f"expected a time after {time_ns} ns, got {switch_ns}"


def _reference_fault(robot: Robot, reference: Any, time_ns: int) -> str:
    """Return the fault of a reference of a user's motion, or an empty text."""
    if fault := kind_fault(reference, Reference):
        return fault
    shapes = {
        "com": (3,),
        "com_velocity": (3,),
        "com_acceleration": (3,),
        "world_from_base": (3, 3),
        "posture": (robot.model.nv - 6,),
    }
    faults = [array_fault(getattr(reference, name), shape, name) for name, shape in shapes.items()]
    faults.append(kind_fault(reference.mode, ContactMode))
    faults.append(kind_fault(reference.swing, SwingState, or_none=True))
    if (reference.mode is ContactMode.DOUBLE_SUPPORT) is not (reference.swing is None):
        faults.append(
            "expected a swing foot in single support alone, got the mode "
            f"{reference.mode!r:.40} with swing {reference.swing!r:.40}"
        )
    return next(filter(None, faults), "")


def standing(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion of the task `balance`."""
    return Standing(robot)


def going(robot: Robot, config: RunConfig) -> Motion:
    """Make the motion of the task `go`. Raise `ConfigError` if no way to the goal is found."""
    ground = make_ground(config.ground, seed=config.seed)
    walk = config.walk
    # Feet that land by touch turn onto a slope. Feet that land by the clock have to be level.
    slopes = config.stepping.mode != "off"
    steps = find_footsteps(robot, walk, ground, walk.place, slopes=slopes)
    motion = Walking(robot, walk, steps=steps)
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
