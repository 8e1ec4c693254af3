"""Carry out an operator's commands on a live robot, between two ticks, and publish them.

The slow work happens on the thread of the command server, or on that of a script. The tick reads
one attribute.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

from robot_node.live import LiveLoop
from robot_node.node import RobotNode
from shared.bus.operator import CommandServer, play_script
from shared.bus.zenoh_bus import ZenohBus
from shared.config.extensions import CONTROLLERS
from shared.errors import ConfigError, LinkError
from shared.wire.operator.commands import (
    Accepted,
    Command,
    EdgeCommand,
    LinkCommand,
    Pause,
    Reset,
    RobotCommand,
    Speed,
    SwitchController,
)
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import CLOCK_KEY, EVENTS_KEY, ROBOT_COMMANDS_KEY, encode_event
from shared.wire.robot_clock import ClockReading, encode_clock

# A script's command is prepared by this time before it is due [ns].
_LEAD_NS = 300_000_000
_LOOK_SECONDS = 0.02
_ATTEMPTS = 3


class _OutdatedError(Exception):
    """The robot has another controller than the one for which a command was prepared."""


class RobotCommands:
    """Serves a robot's commands on the telemetry session `hub`; `say` prints a line for each."""

    def __init__(
        self, hub: ZenohBus, node: RobotNode, loop: LiveLoop, say: Callable[[str], None]
    ) -> None:
        self._node = node
        self._loop = loop
        self._say = say
        self._events = hub.publisher(EVENTS_KEY)
        self._clock = hub.publisher(CLOCK_KEY)
        self._preparing = threading.Lock()
        self._changes = 0
        CommandServer(hub, ROBOT_COMMANDS_KEY, self._carry_out)

    def play(self, script: Sequence[CommandEvent]) -> None:
        """Carry out the commands of a script at their times of the task, on another thread."""
        play_script(script, self._carry_out_due, self._say)

    def _carry_out_due(self, event: CommandEvent) -> None:
        while not self._comes(event.time_ns):
            time.sleep(_LOOK_SECONDS)
        self._carry_out(event.command, at_ns=event.time_ns)

    def _comes(self, time_ns: int) -> bool:
        progress = self._loop.progress
        return progress.running and progress.time_ns >= time_ns - _LEAD_NS

    def tell_clock(self) -> None:
        """Publish the robot's clock, once the task runs."""
        progress, origin = self._loop.progress, self._loop.pace.clock.origin
        if progress.running:
            reading = ClockReading(*origin, now_ns=progress.due_ns, task_ns=progress.time_ns)
            self._clock.publish(encode_clock(reading))

    def _carry_out(self, command: Command, *, at_ns: int = 0) -> Accepted:
        if isinstance(command, LinkCommand | EdgeCommand):
            raise ConfigError(
                f"{command}: expected a command for the robot, got one for the link or the edge"
            )
        if not self._loop.progress.running:
            raise LinkError(f"{command}: the task has not begun yet; try again")
        if self._node.fallen and not isinstance(command, Reset):
            raise LinkError(f"{command}: the robot has fallen; `reset` puts it on its feet")
        time_ns = self._between_ticks(command, at_ns)
        self.tell_clock()
        wall_ns = self._loop.pace.clock.now_ns()
        self._events.publish(encode_event(CommandEvent(time_ns, command), wall_ns=wall_ns))
        self._say(f"{time_ns * 1e-9:.3f} s: operator: {command}")
        return Accepted(time_ns, _note(command))

    def _between_ticks(self, command: RobotCommand, at_ns: int) -> int:
        """Prepare a command and carry it out. Return the task time of its first tick [ns].

        Between the two, an operator's command and one of a script may change the controller.
        """
        for _ in range(_ATTEMPTS):
            with self._preparing:
                changes = self._changes
                action = self._loop.pace.prepare(command) or self._node.prepare(command)
                if isinstance(command, SwitchController | Reset):
                    action = partial(self._change, action, changes)
            try:
                return self._loop.between_ticks(action, at_ns=at_ns)
            except _OutdatedError:
                continue
        raise LinkError(f"{command}: other commands came between {_ATTEMPTS} times; try again")

    def _change(self, action: Callable[[], None], changes: int) -> None:
        if changes != self._changes:
            raise _OutdatedError
        action()
        self._changes += 1


def _note(command: Command) -> str:
    """Return what a user should know about a command beside its time."""
    if isinstance(command, SwitchController):
        return f"{CONTROLLERS.label(command.controller)} takes over with its first answer"
    if isinstance(command, Speed):
        return "the link's delays scale with it; the edge's computing time does not"
    if isinstance(command, Pause):
        return "messages on the link stand still too; the edge goes on"
    return ""
