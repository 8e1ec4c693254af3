"""A scripted scene: commands to a running stack at times of its task, by the robot's clock."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence

from shared.bus.base import Delivery
from shared.bus.operator import CommandClient
from shared.clock import ScaledClock
from shared.errors import MessageRefused, UserError
from shared.wire.operator.commands import Command
from shared.wire.operator.events import CommandEvent, parse_event
from shared.wire.robot_clock import ClockReading, decode_clock

# What `up` without arguments shows beside the push of the settings: a stall, and a cut link.
DEMO = tuple(
    parse_event(text) for text in ("2.2s link outage 300ms", "3.2s link cut", "4.2s link restore")
)
_LOOK_SECONDS = 0.05


class RobotTime:
    """The time of the task, from readings of the robot's clock."""

    def __init__(self) -> None:
        self._clock = ScaledClock()
        self._reading: ClockReading | None = None

    def take(self, delivery: Delivery) -> None:
        """Take in a reading; called on the bus's thread."""
        with contextlib.suppress(MessageRefused):
            reading = decode_clock(delivery.data)
            self._clock.origin, self._reading = reading.origin, reading

    def wait_ns(self, time_ns: int) -> float:
        """Return the time until a time of the task [ns of real time]; infinite if none is known."""
        reading, speed = self._reading, self._clock.speed
        if reading is None or speed == 0.0:
            return float("inf")
        task_ns = reading.task_ns + self._clock.at(time.monotonic_ns()) - reading.now_ns
        return (time_ns - task_ns) / speed


class Sender:
    """Sends commands, one after another, without holding up the loop; refusals are `said`."""

    def __init__(self, client: CommandClient, say: Callable[[str], None]) -> None:
        self._client = client
        self._say = say
        self._lock = asyncio.Lock()

    async def send(self, command: Command) -> None:
        """Send a command and wait for its answer."""
        async with self._lock:
            try:
                await asyncio.to_thread(self._client.send, command)
            except UserError as error:
                self._say(str(error))


async def play(events: Sequence[CommandEvent], robot: RobotTime, sender: Sender) -> None:
    """Send each command at its time."""
    for event in events:
        while (wait_ns := robot.wait_ns(event.time_ns)) > 0:
            await asyncio.sleep(min(wait_ns * 1e-9, _LOOK_SECONDS))
        await sender.send(event.command)
