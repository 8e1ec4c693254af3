"""The report of a robot that decides on its steps, as a part of its state."""

from __future__ import annotations

from typing import Any

import numpy as np

from shared.errors import MessageRefused
from shared.motion.footprint import Footprint
from shared.robots import Foot
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import SwingState
from shared.wire.fields import SINGLE, array_of, finite_numbers, integer_of
from shared.wire.form import INTEGER, binary
from shared.wire.messages import StepReport

# The two soles (x, y, heading, z), then position, velocity, acceleration and heading with its first
# and second derivative of the swing foot, then the disturbance.
_POSES = 8 + 12 + 2
STEP_SLOTS = {
    "phase": INTEGER,
    "phase_ns": INTEGER,
    "plan": INTEGER,
    "law": INTEGER,
    "poses": binary(SINGLE.itemsize * _POSES),
}


def step_values(steps: StepReport) -> tuple[int | bytes, ...]:
    """The values of a report in its slots."""
    poses = np.zeros(_POSES)
    for k, print_ in enumerate(steps.feet):
        poses[4 * k : 4 * k + 4] = print_.x, print_.y, print_.yaw, print_.z
    if (swing := steps.swing) is not None:
        poses[8:17] = np.concatenate((swing.position, swing.velocity, swing.acceleration))
        poses[17:20] = swing.yaw, swing.yaw_rate, swing.yaw_acceleration
    poses[20:] = steps.disturbance
    return (
        steps.phase,
        steps.phase_ns,
        steps.plan,
        steps.law,
        poses.astype(SINGLE).tobytes(),
    )


def steps_of(
    mode: ContactMode, phase: int, phase_ns: int, plan: int, law: int, poses: bytes
) -> StepReport | None:
    """The report in its values; None if one is not valid."""
    numbers = finite_numbers(poses, SINGLE)
    if numbers is None or min(phase, phase_ns, law, plan + 1) < 0:
        return None
    left, right = numbers[:4].tolist(), numbers[4:8].tolist()
    swing = None
    if mode is not ContactMode.DOUBLE_SUPPORT:
        swing = SwingState(numbers[8:11], numbers[11:14], numbers[14:17], *numbers[17:20].tolist())
    feet = (Footprint(Foot.LEFT, *left), Footprint(Foot.RIGHT, *right))
    return StepReport(phase, phase_ns, plan, law, feet, swing, numbers[20:])


def steps_in(fields: Any, mode: ContactMode) -> StepReport:
    """The report in a message without a form. Raise `MessageRefused` if it is not valid."""
    if not isinstance(fields, dict):
        raise MessageRefused("shape", "steps")
    array_of(fields, "poses", (_POSES,), dtype=SINGLE)
    phase, phase_ns = integer_of(fields, "phase"), integer_of(fields, "phase_ns")
    plan, law = integer_of(fields, "plan"), integer_of(fields, "law")
    steps = steps_of(mode, phase, phase_ns, plan, law, fields["poses"])
    if steps is None:
        raise MessageRefused("shape", "steps")
    return steps
