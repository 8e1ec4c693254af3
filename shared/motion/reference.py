"""Reference motion at one instant, and the motion of a standing robot."""

from __future__ import annotations

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
    """A reference for every task time, and the contact switches ahead."""

    def reference(self, time_ns: int) -> Reference:
        """Reference at `time_ns` since the task began."""
        ...

    def next_switch(self, time_ns: int) -> tuple[int, ContactMode] | None:
        """When the contact mode changes next after `time_ns`, and to which; None for never."""
        ...


class Standing:
    """The robot's standing configuration, for ever."""

    def __init__(self, robot: Robot) -> None:
        data = robot.model.createData()
        q = robot.q_standing
        com = pin.centerOfMass(robot.model, data, q).copy()
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

    def next_switch(self, time_ns: int) -> tuple[int, ContactMode] | None:
        return None
