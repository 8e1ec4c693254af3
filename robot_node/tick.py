"""Drives a robot node through its ticks: live, in lockstep and in tests alike.

`begin` is the first phase of Eq. (7), `end` the second, d* later. The driver decides when each is
due, and collects the messages that have arrived in between.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np

from robot_node.controllers import Command
from robot_node.node import RobotNode
from shared.bus.base import Delivery
from shared.telemetry.row_log import RowLog


class Tick:
    """Plays the ticks of one robot. `next_row` gives the row of each tick; without it there are no
    rows. `steps` gets the rows of footprints.
    """

    def __init__(
        self,
        node: RobotNode,
        next_row: Callable[[], np.ndarray] | None = None,
        steps: RowLog | None = None,
    ) -> None:
        self._node = node
        self._next_row = next_row
        self._steps = steps
        self._cost_ns = 0

    def begin(self, now_ns: int) -> bytes:
        """Sense. Return the state message to send."""
        began_ns = time.perf_counter_ns()
        message = self._node.measure(now_ns)
        self._cost_ns = time.perf_counter_ns() - began_ns
        return message

    def end(
        self,
        now_ns: int,
        arrived: Iterable[Delivery],
        *,
        late_ns: int = 0,
        overruns: int = 0,
        sending_ns: int = 0,
        plans: Iterable[Delivery] = (),
    ) -> tuple[Command, bool]:
        """Take in the arrived messages, command, record, move.

        Return the command, and whether an answer was taken. `late_ns` and `overruns` are those of
        the driver's schedule. `sending_ns` is the time that sending the state took. `plans` are the
        messages on the key of plans.
        """
        node = self._node
        began_ns = time.perf_counter_ns()
        taken = [node.receive(delivery) for delivery in arrived]
        for delivery in plans:
            node.receive_plan(delivery)
        command = node.command(now_ns)
        self._cost_ns += time.perf_counter_ns() - began_ns
        row = None
        if self._next_row is not None:
            row = self._next_row()
            columns = node.schema.slices
            row[columns["tick_ns"]] = self._cost_ns + sending_ns
            row[columns["late_ns"]] = late_ns
            row[columns["overruns"]] = overruns
        node.advance(command, row, self._steps)
        return command, any(taken)
