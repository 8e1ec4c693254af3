"""Two clocks behind one protocol, and a ticker on an absolute schedule.

All times between modules are integer nanoseconds. A live run reads the machine's monotonic
clock, which a `ScaledClock` may slow down; a lockstep run moves a `SimClock` from event to event.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """A source of time."""

    def now_ns(self) -> int:
        """Return the time since an arbitrary origin [ns]. It never goes back."""
        ...


@dataclass
class SimClock:
    """A clock that its owner moves."""

    time_ns: int = 0

    def now_ns(self) -> int:
        return self.time_ns


class ScaledClock:
    """The machine's monotonic clock, or one that runs slower or stands still after `run_at`.

    `origin` (monotonic [ns], own time [ns], speed) says when the speed was set last. Another
    process that sets the same origin has the same clock.
    """

    def __init__(self) -> None:
        self.origin = (0, 0, 1.0)

    @property
    def speed(self) -> float:
        """The rate of this clock by the monotonic clock; 0 while this clock stands still."""
        return self.origin[2]

    def now_ns(self) -> int:
        return self.at(time.monotonic_ns())

    def at(self, monotonic_ns: int) -> int:
        """Return the own time at a time of the monotonic clock [ns]."""
        begun_ns, own_ns, speed = self.origin
        elapsed_ns = monotonic_ns - begun_ns
        return own_ns + (elapsed_ns if speed == 1.0 else int(elapsed_ns * speed))

    def run_at(self, speed: float) -> None:
        """Go on from now at a speed, at least 0."""
        monotonic_ns = time.monotonic_ns()
        self.origin = (monotonic_ns, self.at(monotonic_ns), speed)

    def sleep_until(self, due_ns: int) -> None:
        """Return soon after `due_ns` of this clock, as `sleep_until`.

        Return at once while the clock stands still.
        """
        begun_ns, own_ns, speed = self.origin
        if speed > 0.0:
            wait_ns = due_ns - own_ns
            sleep_until(begun_ns + (wait_ns if speed == 1.0 else math.ceil(wait_ns / speed)))


def sleep_until(due_ns: int) -> None:
    """Return soon after `due_ns` of the monotonic clock, never before; at once if it has passed.

    It does not spin, because spinning takes time from the other processes of the stack. With the
    timer slack that `realtime.prepare` asks for, a thread wakes about 30 µs late.
    """
    while (remaining_ns := due_ns - time.monotonic_ns()) > 0:
        time.sleep(remaining_ns * 1e-9)


class Ticker:
    """Absolute schedule of a periodic loop: tick k is due at start + k · period.

    A tick that finishes after the next one is due is an overrun, and is counted. The following
    ticks run back to back until the schedule is met again, so that simulated time keeps up with the
    wall clock. A tick that is late by more than `max_backlog_ns` moves the schedule instead, and
    the ticks given up are counted. So one long halt does not become a burst.
    """

    def __init__(self, *, start_ns: int, period_ns: int, max_backlog_ns: int = 50_000_000) -> None:
        self.period_ns = period_ns
        self.max_backlog_ns = max_backlog_ns
        self.due_ns = start_ns
        self.overruns = 0
        self.ticks_given_up = 0

    def next(self, now_ns: int) -> int:
        """Close the current tick at `now_ns`; return when the next one is due [ns]."""
        self.due_ns += self.period_ns
        late_ns = now_ns - self.due_ns
        if late_ns > 0:
            self.overruns += 1
            if late_ns > self.max_backlog_ns:
                given_up = late_ns // self.period_ns
                self.ticks_given_up += given_up
                self.due_ns += given_up * self.period_ns
        return self.due_ns
