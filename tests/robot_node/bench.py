"""The robot's tick by hand: measure, receive what the test says, command, record, advance."""

from __future__ import annotations

import numpy as np

from edge_node.node import EdgeNode
from robot_node.node import RobotNode
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
        self.commands = []

    def tick(self, *, deliver=lambda answer: [answer]):
        """One period; `deliver` turns the edge's answer into the messages that arrive."""
        self.sent = self.robot.measure(self.now_ns)
        self.edge.receive(self.sent)
        answer = self.edge.step()
        if answer is not None and answer.data is not None:
            for data in deliver(answer.data):
                self.robot.receive(data)
        command = self.robot.command(self.now_ns + DEADLINE_NS)
        row = np.zeros(self.robot.schema.width)
        self.robot.record(row, command)
        self.robot.advance(command)
        self.now_ns += MS
        self.rows.append(row)
        self.commands.append(command)
        return command

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
