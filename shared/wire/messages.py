"""The messages of the link. `docs/wire.md` documents their encoding field by field.

The messages of every millisecond are not frozen, because a frozen one takes five times as long to
make.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.motion.footprint import Footprint
from shared.motion.planned import Plan
from shared.motion.step_law import StepLaw
from shared.wbc.answer import Factorisation, TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import SwingState


@dataclass(slots=True)
class StepReport:
    """The steps of a robot that decides on them itself.

    `phase` counts the phases of its contact clock, `phase_ns` is the time in the present one.
    `plan` is the number of the plan that it follows, −1 without one, `law` the identity of its step
    law, 0 without one. `feet` are its soles; a swing foot has the place from which it lifted.
    `swing` is the reference of the swing foot. `disturbance` (2,) is the external force as a shift
    of the CoP [m]. Poses are in the plan's frame, in single precision.
    """

    phase: int
    phase_ns: int
    plan: int
    law: int
    feet: tuple[Footprint, Footprint]
    swing: SwingState | None
    disturbance: np.ndarray


@dataclass(slots=True)
class RobotState:
    """Uplink, 1 kHz: the measured state of one tick.

    `session` tells one start of the robot from the next; `sequence` counts ticks within it.
    `stamp_ns` is the robot's clock at the measurement and means nothing elsewhere; `time_ns` is the
    time of the task, from which both ends derive the reference. `q` (nq,), `v` (nv,).
    `held_sequences`: per contact mode, the state whose factorisation the robot has, −1 for none;
    None for a robot that wants projectors. `com_command` (2,): the acceleration that the robot's
    balance law asks of the CoM in the plane, None without a law [m/s²]. `steps` is None for a robot
    whose motion is a function of time.
    """

    session: int
    sequence: int
    stamp_ns: int
    time_ns: int
    mode: ContactMode
    q: np.ndarray
    v: np.ndarray
    held_sequences: tuple[int, ...] | None = None
    com_command: np.ndarray | None = None
    steps: StepReport | None = None


@dataclass(slots=True)
class ProjectorMessage:
    """Downlink: the result of the edge for one state, whose identity it echoes.

    `tau` (nv − 6,) [N m] and `y` (n,) are the full solution at that state. A purely remote
    controller uses nothing else. `projectors` holds at least the one of `mode`, possibly others for
    later modes.
    """

    session: int
    sequence: int
    stamp_ns: int
    mode: ContactMode
    tau: np.ndarray
    y: np.ndarray
    projectors: tuple[TimedProjector, ...]


@dataclass(frozen=True, slots=True)
class FactorisationMessage:
    """Downlink to a robot that corrects: factorisations at the state whose identity it echoes.

    A message without factorisations only says that the edge is there.
    """

    session: int
    sequence: int
    stamp_ns: int
    factorisations: tuple[Factorisation, ...]


@dataclass(frozen=True, slots=True)
class PlanMessage:
    """Downlink on its own key: a plan or a step law, as answer to the state that it echoes."""

    session: int
    sequence: int
    stamp_ns: int
    content: Plan | StepLaw
