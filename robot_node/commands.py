"""Carries an operator's commands out on a live robot, between two ticks, and publishes them.

Everything slow happens on the thread of the command server. The tick looks at one attribute.
"""

from __future__ import annotations

from collections.abc import Callable

from robot_node.live import LiveLoop
from robot_node.node import RobotNode
from shared.bus.operator import CommandServer
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
    Speed,
    SwitchController,
)
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import CLOCK_KEY, EVENTS_KEY, ROBOT_COMMANDS_KEY, encode_event
from shared.wire.robot_clock import ClockReading, encode_clock


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
        CommandServer(hub, ROBOT_COMMANDS_KEY, self._carry_out)

    def tell_clock(self) -> None:
        """Publish the robot's clock, once the task runs."""
        progress, origin = self._loop.progress, self._loop.pace.clock.origin
        if progress.running:
            reading = ClockReading(*origin, now_ns=progress.due_ns, task_ns=progress.time_ns)
            self._clock.publish(encode_clock(reading))

    def _carry_out(self, command: Command) -> Accepted:
        if isinstance(command, LinkCommand | EdgeCommand):
            raise ConfigError(f"{command}: expected a command for the robot, not link or edge")
        if not self._loop.progress.running:
            raise LinkError(f"{command}: the task has not begun yet; try again")
        if self._node.fallen and not isinstance(command, Reset):
            raise LinkError(f"{command}: the robot has fallen; `reset` puts it on its feet")
        action = self._loop.pace.prepare(command) or self._node.prepare(command)
        time_ns = self._loop.between_ticks(action)
        self.tell_clock()
        wall_ns = self._loop.pace.clock.now_ns()
        self._events.publish(encode_event(CommandEvent(time_ns, command), wall_ns=wall_ns))
        self._say(f"{time_ns * 1e-9:.3f} s: operator: {command}")
        return Accepted(time_ns, _note(command))


def _note(command: Command) -> str:
    """Return what a user should know about a command beside its time."""
    if isinstance(command, SwitchController):
        return f"{CONTROLLERS.label(command.controller)} takes over with its first answer"
    if isinstance(command, Speed):
        return "the link's delays scale with it; the edge's computing time does not"
    if isinstance(command, Pause):
        return "messages on the link stand still too; the edge goes on"
    return ""
