"""The target of the tasks: a reference at one instant, and the motion that gives it."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from shared.wbc.contacts import ContactMode


@dataclass(slots=True)
class SwingState:
    """Sole frame of the swing foot: position, velocity, acceleration (3,) in the world; heading
    [rad] and its first and second derivative."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    yaw: float
    yaw_rate: float
    yaw_acceleration: float


@dataclass(slots=True)
class Reference:
    """The target of the tasks at one instant.

    `com`, `com_velocity`, `com_acceleration` (3,) in the world; `world_from_base` (3, 3); `posture`
    (nv − 6,) joint positions [rad]; `mode` the planned contact mode. `com_command` (2,) is the
    acceleration in the plane that a balance law asks of the CoM, instead of the task's feedback.
    """

    com: np.ndarray
    com_velocity: np.ndarray
    com_acceleration: np.ndarray
    world_from_base: np.ndarray
    posture: np.ndarray
    mode: ContactMode
    swing: SwingState | None = None
    com_command: np.ndarray | None = None


class Motion(Protocol):
    """A reference for every task time, and the contact switches ahead.

    `digest`: eight bytes that identify this motion. The two ends of a link compare them.
    """

    digest: bytes

    def reference(self, time_ns: int) -> Reference:
        """Reference at `time_ns` since the task began."""
        ...

    def next_switch(self, time_ns: int) -> int | None:
        """Return the time of the next contact switch after `time_ns`, or None if there is none."""
        ...

    def stopped(self, time_ns: int) -> Motion:
        """Return the motion that is the same until `time_ns`, then comes to a stand as soon as
        possible.
        """
        ...


def turned(yaw: float) -> np.ndarray:
    """Rotation by `yaw` [rad] about the vertical, (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def motion_digest(*parts: np.ndarray) -> bytes:
    """Eight bytes of positions and times, to a tenth of a millimetre or of a millisecond.

    This is coarser than the rounding by which two machines may differ.
    """
    rounded = [np.round(np.asarray(part, dtype=float) * 1e4).astype(np.int64) for part in parts]
    return hashlib.sha256(b"".join(part.tobytes() for part in rounded)).digest()[:8]


def coming_switches(motion: Motion, time_ns: int) -> list[int]:
    """Times of the next two contact switches after `time_ns`, fewer if there are no more.

    There are two, because a double support can be shorter than the preparation for its end.
    """
    times: list[int] = []
    while len(times) < 2 and (switch_ns := motion.next_switch(time_ns)) is not None:
        times.append(switch_ns)
        time_ns = switch_ns
    return times
