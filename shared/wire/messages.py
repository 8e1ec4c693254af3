"""The messages of the link. `docs/wire.md` documents their encoding field by field.

The messages of every millisecond are not frozen, because a frozen one takes five times as long to
make.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.wbc.answer import Factorisation, TimedProjector
from shared.wbc.contacts import ContactMode


@dataclass(slots=True)
class RobotState:
    """Uplink, 1 kHz: the measured state of one tick.

    `session` tells one start of the robot from the next; `sequence` counts ticks within it.
    `stamp_ns` is the robot's clock at the measurement and means nothing elsewhere; `time_ns` is the
    time of the task, from which both ends derive the reference. `q` (nq,), `v` (nv,).
    `held_sequences`: per contact mode, the state whose factorisation the robot has, −1 for none;
    None for a robot that wants projectors. `com_command` (2,): the acceleration that the robot's
    balance law asks of the CoM in the plane, None without a law [m/s²].
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
