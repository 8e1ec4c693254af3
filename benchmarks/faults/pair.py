"""A robot and an edge, tick by tick, whose messages the caller can add to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from edge_node.node import EdgeNode
from robot_node.node import RobotNode
from robot_node.tick import Tick
from shared.bus.base import Delivery
from shared.config.settings import RunConfig
from shared.motion.plan import make_motion
from shared.robots import load_robot
from shared.wire.codec import Codec

_SESSION = 5
# More than sessions can wait at an edge.
_MAX_ANSWERS = 16

# Turns a sent message into the arriving messages, in order.
Arrive = Callable[[bytes], list[bytes]]


def unchanged(data: bytes) -> list[bytes]:
    """Let a message arrive as it is."""
    return [data]


class Pair:
    """A robot and its edge without a link: answers arrive in the tick of their state."""

    def __init__(self, config: RunConfig) -> None:
        robot = load_robot(config.robot.name)
        motion = make_motion(robot, config)
        self.robot = RobotNode(robot, config, motion, session=_SESSION)
        self.edge = EdgeNode(robot, config, motion)
        self.codec = Codec(robot, config, motion)
        self.limit = config.robot.torque_clamp * robot.effort_limit
        self._period_ns = config.loop.period_ns
        self._command_ns = config.loop.fresh_within_ns
        self._now_ns = 0
        self._rows: list[np.ndarray] = []
        self._tick = Tick(self.robot, self._next_row)

    def tick(
        self,
        *,
        uplink: Arrive = unchanged,
        downlink: Arrive = unchanged,
        plans: Arrive = unchanged,
    ) -> None:
        """Play one period. An edge that has several states to answer answers all of them."""
        for state in uplink(self._tick.begin(self._now_ns)):
            self.edge.receive(state, self._now_ns)
        answers = []
        for _ in range(_MAX_ANSWERS):
            answer = self.edge.step()
            if answer is None:
                break
            if answer.data is not None:
                answers.append(answer.data)
        arrived = [Delivery(data, None) for answer in answers for data in downlink(answer)]
        planned = [
            Delivery(data, None) for _, plan in self.edge.take_plans() for data in plans(plan)
        ]
        self._tick.end(self._now_ns + self._command_ns, arrived, plans=planned)
        self._now_ns += self._period_ns

    def column(self, name: str) -> np.ndarray:
        """Return a column of all ticks' rows."""
        return self.robot.schema.column(np.array(self._rows), name)

    def _next_row(self) -> np.ndarray:
        self._rows.append(np.zeros(self.robot.schema.width))
        return self._rows[-1]
