"""The robot's clock on the telemetry session: for processes that mark the time of the task.

Simulated time may run slower than real time, or stand still. The robot publishes the state of its
clock at every change and some times a second. The shim delays messages by the same clock.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import msgpack

from shared.errors import MessageRefused
from shared.wire.operator.commands import TICK_NS

_MAX_BYTES = 100
# The errors that bytes of another program may raise.
_UNREADABLE = (msgpack.UnpackException, TypeError, ValueError, OverflowError)


@dataclass(frozen=True)
class ClockReading:
    """A reading of the robot's clock.

    The first three fields are the `origin` of a `ScaledClock`. At `now_ns` of that clock the task
    is at `task_ns`.
    """

    monotonic_ns: int
    own_ns: int
    speed: float
    now_ns: int
    task_ns: int

    @property
    def origin(self) -> tuple[int, int, float]:
        """The origin of the robot's `ScaledClock`."""
        return self.monotonic_ns, self.own_ns, self.speed

    def tick_from(self, now_ns: int) -> int:
        """Return the task time of the first tick that begins after a time of the clock [ns]."""
        task_ns = self.task_ns + now_ns - self.now_ns
        return max(0, -(-task_ns // TICK_NS) * TICK_NS)


def encode_clock(reading: ClockReading) -> bytes:
    """Return the message of a reading."""
    return bytes(msgpack.packb(astuple(reading)))


def decode_clock(data: bytes) -> ClockReading:
    """Return a reading; raise `MessageRefused` if it is none."""
    try:
        if len(data) > _MAX_BYTES:
            raise ValueError
        *times, speed, now_ns, task_ns = msgpack.unpackb(data)
        monotonic_ns, own_ns = (int(each) for each in times)
        if not 0.0 <= float(speed) <= 1.0:
            raise ValueError
        return ClockReading(monotonic_ns, own_ns, float(speed), int(now_ns), int(task_ns))
    except _UNREADABLE:
        raise MessageRefused(
            "clock", "expected a reading of the robot's clock, got another value"
        ) from None
