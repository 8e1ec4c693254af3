"""Reference motion at one instant, and the motion of a standing robot."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from shared.motion.swing import SwingState
from shared.robots import Robot
from shared.wbc.contacts import ContactMode


@dataclass(frozen=True, slots=True)
class Reference:
    """What the tasks track at one instant.

    `com`, `com_velocity`, `com_acceleration` (3,) in the world; `world_from_base` (3, 3);
    `posture` (nv − 6,) joint positions [rad]; `mode` the planned contact mode.
    """

    com: np.ndarray
    com_velocity: np.ndarray
    com_acceleration: np.ndarray
    world_from_base: np.ndarray
    posture: np.ndarray
    mode: ContactMode
    swing: SwingState | None = None


class Motion(Protocol):
    """A reference for every task time, and the contact switches ahead.

    `digest`: eight bytes that tell this motion from others, compared by the two ends of a link.
    """

    digest: bytes

    def reference(self, time_ns: int) -> Reference:
        """Reference at `time_ns` since the task began."""
        ...

    def next_switch(self, time_ns: int) -> int | None:
        """When the contact mode changes next after `time_ns`; None for never."""
        ...

    def stopped(self, time_ns: int) -> Motion:
        """The same motion until `time_ns`, from then on to a stand as soon as it can be."""
        ...


def motion_digest(*parts: np.ndarray) -> bytes:
    """Eight bytes of positions and times, to a tenth of a millimetre or of a millisecond.

    Coarser than the rounding by which two machines may differ.
    """
    rounded = [np.round(np.asarray(part, dtype=float) * 1e4).astype(np.int64) for part in parts]
    return hashlib.sha256(b"".join(part.tobytes() for part in rounded)).digest()[:8]


class Standing:
    """The robot's standing configuration, for ever."""

    def __init__(self, robot: Robot) -> None:
        data = robot.model.createData()
        q = robot.q_standing
        com = pin.centerOfMass(robot.model, data, q).copy()
        self.digest = motion_digest(com, q[7:])
        self._reference = Reference(
            com=com,
            com_velocity=np.zeros(3),
            com_acceleration=np.zeros(3),
            world_from_base=pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix(),
            posture=q[7:].copy(),
            mode=ContactMode.DOUBLE_SUPPORT,
        )

    def reference(self, time_ns: int) -> Reference:
        return self._reference

    def next_switch(self, time_ns: int) -> int | None:
        return None

    def stopped(self, time_ns: int) -> Standing:
        return self


def coming_switches(motion: Motion, time_ns: int) -> list[int]:
    """Times of the next two contact switches after `time_ns`, fewer if there are no more.

    Two, because a double support can be shorter than what it takes to prepare for its end.
    """
    times: list[int] = []
    while len(times) < 2 and (switch_ns := motion.next_switch(time_ns)) is not None:
        times.append(switch_ns)
        time_ns = switch_ns
    return times
