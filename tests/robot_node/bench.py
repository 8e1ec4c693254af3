"""A robot and an edge, tick by tick; what arrives is the test's to say."""

from __future__ import annotations

import numpy as np

from edge_node.node import EdgeNode
from robot_node.node import RobotNode
from robot_node.tick import Tick
from shared.bus.base import Delivery
from shared.wire.codec import Codec

MS = 1_000_000
SESSION = 5
DEADLINE_NS = 500_000


class Bench:
    """A robot and an edge whose messages pass through the test's hands.

    To a robot that corrects the edge does not answer every state.
    """

    def __init__(self, robot, motion, config):
        self.robot = RobotNode(robot, config, motion, session=SESSION)
        self.edge = EdgeNode(robot, config, motion)
        self.codec = Codec(robot, config, motion)
        self.now_ns = 0
        self.rows = []
        self._tick = Tick(self.robot, self._next_row)
        self.commands = []

    def tick(self, *, deliver=lambda answer: [answer]):
        """One period; `deliver` turns the edge's answer into the messages that arrive."""
        self.sent = self._tick.begin(self.now_ns)
        self.edge.receive(self.sent, self.now_ns)
        answer = self.edge.step()
        arrived = []
        if answer is not None and answer.data is not None:
            arrived = [Delivery(data, None) for data in deliver(answer.data)]
        command, _ = self._tick.end(self.now_ns + DEADLINE_NS, arrived)
        self.now_ns += MS
        self.commands.append(command)
        return command

    def _next_row(self):
        self.rows.append(np.zeros(self.robot.schema.width))
        return self.rows[-1]

    def run(self, ticks, **how):
        for _ in range(ticks):
            self.tick(**how)
        return self

    def column(self, name):
        return self.robot.schema.column(np.array(self.rows), name)

    @property
    def state(self):
        """What the robot measured and sent in the last tick."""
        return self.codec.decode_state(self.sent)

    def doctored(self, change):
        """`deliver` with the answer's message changed: checked, decoded, changed, encoded."""

        def deliver(answer):
            return [self.codec.encode_projector(change(self.codec.decode_projector(answer)))]

        return deliver


def nothing(answer):
    return []
