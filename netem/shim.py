"""The shim: two delay lines between a near side (the robot) and a far side (the edge).

Messages come in on the buses' threads and go out on one releasing thread, which sleeps until just
before the next one is due. If sender and shim read the same clock, a message is due its nominal
delay after it was *sent*. Otherwise it is due that delay after it arrived. The shim does not read
payloads. Messages under way take bounded memory.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from netem.delay_line import DelayLine, Due, apply_to, make_lines
from netem.profile import Profile, begin_ns
from shared.bus.base import Delivery, Publisher
from shared.clock import ScaledClock
from shared.config.link_settings import LinkConfig
from shared.errors import LinkError
from shared.wire.operator.commands import LinkCommand

_IDLE_SECONDS = 0.1
# Messages of each direction released in one go. At the end of an outage hundreds of messages leave
# in one direction; they must not hold the other direction back.
_BATCH = 4
# Limit for messages under way: 26 s of both directions at full rate. Further messages are lost.
_MAX_BYTES = 2**30
# A constant profile is one period long, so its repetition is not reported.
_CONSTANT_SECONDS = 0.01


@dataclass(frozen=True)
class Sides:
    """The publishers of both directions: `uplink` on the far bus, the others on the near bus."""

    uplink: Publisher
    downlink: Publisher
    plans: Publisher


class Shim:
    """A shim that delays messages both ways. `receive` is given to the buses, `run` to a thread.

    `row` gives the next row of `LINK_SCHEMA` to fill. `clock` is the identity of this machine's
    clock in envelopes; with 0 the shim uses no stamp. For the last `spin_ns` before a message is
    due, the thread spins. The shim's `time` is that of the robot, so that delays scale with
    simulated time.
    """

    def __init__(
        self,
        profile: Profile,
        config: LinkConfig,
        *,
        seed: int,
        sides: Sides,
        row: Callable[[], np.ndarray],
        clock: int,
        say: Callable[[str], None],
        spin_ns: int = 0,
    ) -> None:
        self.time = ScaledClock()
        self._spin_ns = spin_ns
        self._profile = profile
        self._config = config
        self._seed = seed
        self._publishers = (sides.uplink, sides.downlink)
        self._plans = sides.plans
        self._row = row
        self._clock = clock
        self._say = say
        self._lines: list[DelayLine[Delivery]] = []
        self._changed = threading.Condition()
        self._held_bytes = 0
        self._overflowed = False
        self._over = False
        self.passes = 0

    @property
    def under_way(self) -> int:
        """The number of messages that wait to be released."""
        return sum(len(line) for line in self._lines)

    def receive(self, direction: int, *, plans: bool = False) -> Callable[[Delivery], None]:
        """The callback for the messages of one direction, or for its `plans`."""

        def take(delivery: Delivery) -> None:
            if plans:
                delivery = delivery._replace(on_plans=True)
            sent_ns = self._sent_ns(delivery)
            with self._changed:
                if self._over:
                    return
                if not self._lines:
                    self._start(sent_ns)
                line = self._lines[direction]
                due_ns = None
                if self._has_room(delivery):
                    due_ns = line.push(delivery, sent_ns=sent_ns, size=len(delivery.data))
                if due_ns is None:
                    lost = Due(delivery, sent_ns, 0)
                    record_message(self._row(), direction, lost, released_ns=None)
                    return
                self._held_bytes += len(delivery.data)
                if line.next_due_ns == due_ns:
                    self._changed.notify()

        return take

    def change(self, command: LinkCommand, profile: Profile | None) -> int:
        """Carry out an operator's command. Return the time from which it holds [ns].

        `profile` is the one that the command names. Raise `LinkError` before the first message.
        """
        with self._changed:
            if not self._lines:
                raise LinkError(f"{command}: no message has come to the link yet; try again")
            now_ns = self.time.now_ns()
            apply_to(
                self._lines,
                command,
                now_ns=now_ns,
                profile=profile,
                config=self._config,
                seed=self._seed,
            )
            if profile is not None:
                self._profile = profile
                self.passes = self._lines[0].passes(now_ns)
            return now_ns

    def set_time(self, origin: tuple[int, int, float]) -> None:
        """Continue in the robot's time, by the origin of its clock."""
        if origin != self.time.origin:
            with self._changed:
                self.time.origin = origin
                self._changed.notify()

    def run(self, stopping: Callable[[], bool]) -> None:
        """Release messages until `stopping()`. Messages that arrive later are ignored."""
        while not stopping():
            if self._wait_for_work():
                self._release()
        with self._changed:
            self._over = True

    def _sent_ns(self, delivery: Delivery) -> int:
        """The sending time [ns]: the message's stamp if it is of our clock, or else the present."""
        now_ns, envelope = time.monotonic_ns(), delivery.envelope
        if envelope is None or envelope.clock != self._clock or self._clock == 0:
            return self.time.at(now_ns)
        # A stamp in the future is wrong. All later messages would wait behind such a message.
        return self.time.at(min(envelope.sent_ns, now_ns))

    def _has_room(self, delivery: Delivery) -> bool:
        """Return whether there is room for one more message. Report the first overflow."""
        if self._held_bytes + len(delivery.data) <= _MAX_BYTES:
            return True
        if not self._overflowed:
            self._overflowed = True
            self._say(f"{_MAX_BYTES >> 20} MiB are under way; messages without room are lost")
        return False

    def _start(self, start_ns: int) -> None:
        """Begin the profile with the first message."""
        self._lines = make_lines(self._profile, self._config, seed=self._seed, start_ns=start_ns)
        offset_ns = begin_ns(self._profile, self._config, seed=self._seed)
        self._say(f"replaying {self._profile.name} from {offset_ns * 1e-9:.3f} s")

    def _wait_for_work(self) -> bool:
        """Sleep until a message is due or the queue changes. Return whether one is due."""
        with self._changed:
            due = [line.next_due_ns for line in self._lines if line.next_due_ns is not None]
            if not due:
                self._changed.wait(_IDLE_SECONDS)
                return False
            due_ns, speed = min(due), self.time.speed
            sleep_ns = due_ns - self.time.now_ns() - self._spin_ns
            if sleep_ns > 0:
                # Wake up during a long outage too, to see a request to stop.
                seconds = sleep_ns * 1e-9 / speed if speed > 0.0 else _IDLE_SECONDS
                self._changed.wait(min(seconds, _IDLE_SECONDS))
                return False
        # Spin without the lock, so that messages come in meanwhile.
        while self.time.now_ns() < due_ns:
            if self.time.speed == 0.0:
                return False
        return True

    def _release(self) -> None:
        with self._changed:
            now_ns = self.time.now_ns()
            ready = [line.pop_due(now_ns, limit=_BATCH) for line in self._lines]
            passes = self._lines[0].passes(now_ns)
        released = []
        for direction, messages in enumerate(ready):
            for due in messages:
                publisher = self._plans if due.item.on_plans else self._publishers[direction]
                publisher.forward(due.item)
                released.append((direction, due, self.time.now_ns()))
        with self._changed:
            for direction, due, released_ns in released:
                self._held_bytes -= len(due.item.data)
                record_message(self._row(), direction, due, released_ns=released_ns)
        if passes > self.passes:
            self.passes = passes
            seconds = self._profile.duration_ns * 1e-9
            if seconds > _CONSTANT_SECONDS:
                self._say(f"profile {self._profile.name} ended after {seconds:g} s and repeats")


def record_message(
    row: np.ndarray, direction: int, due: Due[Delivery], *, released_ns: int | None
) -> None:
    """Fill a row of `LINK_SCHEMA`. `released_ns` is None for a message that the link lost."""
    envelope = due.item.envelope
    # The order is that of the schema's columns.
    row[:] = (
        due.sent_ns,
        direction,
        -1 if envelope is None else envelope.sequence,
        len(due.item.data),
        due.nominal_ns,
        -1 if released_ns is None else released_ns - due.sent_ns,
    )
