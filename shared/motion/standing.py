"""The motion of a standing robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.robots import Robot
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Reference, motion_digest


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
