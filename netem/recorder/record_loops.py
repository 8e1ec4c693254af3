"""Loops of the two ends of a recording, which send on an absolute schedule.

A loop that wakes late skips the messages that are overdue. In a burst they would queue behind one
another, and the recording would measure that queue. The bus's thread also sends, so on arrival it
only stamps a message. The loop reads the message in the rest of a period.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from datetime import datetime, timezone
from typing import NamedTuple

from netem.recorder.probe import DOWN_BYTES_READ, Instant, version_notice
from netem.recorder.probe_far import FarEnd, FarRecording
from netem.recorder.probe_near import NearEnd
from shared.bus.base import Delivery, Publisher
from shared.bus.zenoh_bus import machine_clock
from shared.clock import Ticker, sleep_until
from shared.errors import LinkError

START_FAR = "./wbc netem record --listen tcp/0.0.0.0:7460"
CONNECT_SECONDS = 10.0
# Both streams run for this time before the measurement, so that connections and windows are open.
SETTLE_SECONDS = 0.2
# A message without a report counts as lost this long after the measurement, or after `_QUIET_NS`
# without a new stamp.
DRAIN_SECONDS = 10.0
_QUIET_NS = 3_000_000_000
_DRAIN_PERIOD_NS = 10_000_000
_IDLE_SECONDS = 0.05
# Eight seconds of backlog at 1 kHz, more than any running loop is late.
_MAX_ARRIVALS = 8192
# The end of a period stays free, so that the next sending is in time.
_MARGIN_NS = 150_000


class Arrival(NamedTuple):
    """A message, or the part of it that is read, and the time of its arrival."""

    data: bytes
    now: Instant
    one_clock: bool


class Arrivals:
    """A queue from the bus's thread to the loop; `missed` counts messages without room."""

    def __init__(self, *, read: int | None) -> None:
        self.missed = 0
        self.arrived = threading.Event()
        self._read = read
        self._clock = machine_clock()
        self._queue: deque[Arrival] = deque()

    def put(self, delivery: Delivery) -> None:
        """Take in a message; called on the bus's thread."""
        now = Instant.now()
        if len(self._queue) >= _MAX_ARRIVALS:
            self.missed += 1
            return
        envelope = delivery.envelope
        one_clock = envelope is not None and envelope.clock == self._clock != 0
        self._queue.append(Arrival(delivery.data[: self._read], now, one_clock))
        self.arrived.set()

    def read_until(self, due_ns: int, read: Callable[[Arrival], None]) -> None:
        """Read the queued messages, at least one, until shortly before `due_ns`."""
        while self._queue:
            read(self._queue.popleft())
            if Instant.now().monotonic_ns > due_ns - _MARGIN_NS:
                return


class NearLoop:
    """The loop of a near end: connect, measure, drain."""

    def __init__(self, near: NearEnd, publisher: Publisher) -> None:
        self.near = near
        self.began = datetime.now(timezone.utc)
        self.left_seconds = 0.0
        self._publisher = publisher
        self._arrivals = Arrivals(read=DOWN_BYTES_READ)
        self._ticker = _make_ticker(near.settings.period_ns)

    @property
    def missed(self) -> int:
        """The number of messages down that arrived when the queue was full. They count as lost."""
        return self._arrivals.missed

    @property
    def given_up(self) -> int:
        """The number of messages up that were skipped."""
        return self._ticker.ticks_given_up

    def receive(self, delivery: Delivery) -> None:
        """Take in a message from the far end; called on the bus's thread."""
        self._arrivals.put(delivery)

    def _read(self, arrival: Arrival) -> None:
        self.near.take(arrival.data, arrival.now, one_clock=arrival.one_clock)

    def connect(self, endpoint: str, stopping: Callable[[], bool]) -> bool:
        """Send until messages pass both ways. Return False if stopped before.

        Raise `LinkError` if no far end answers, or a far end of another version.
        """
        near = self.near
        self._ticker = ticker = _make_ticker(near.settings.period_ns)
        limit_ns = ticker.due_ns + round(CONNECT_SECONDS * 1e9)
        while not near.answered:
            if stopping():
                return False
            if near.other_version:
                raise LinkError(
                    f"the far end at {endpoint} runs another version of this project "
                    f"({near.other_version}); install the same version on both machines"
                )
            if self._tick(ticker).monotonic_ns > limit_ns:
                raise LinkError(self._unanswered(endpoint))
        return True

    def measure(self, *, seconds: float, stopping: Callable[[], bool]) -> tuple[int, int]:
        """Measure for `seconds`. Return start and end [ns] on the clock of the recording."""
        settings, ticker = self.near.settings, self._ticker
        for _ in range(round(SETTLE_SECONDS * 1e9 / settings.period_ns)):
            self._tick(ticker)
        ticker.ticks_given_up = 0
        self.began = datetime.now(timezone.utc)
        # Messages are sent in the middle of their periods, so a late one stays in its period.
        first = self._tick(ticker)
        start_ns = first.stamp_ns(settings) - settings.period_ns // 2
        asked = max(1, round(seconds * 1e9 / settings.period_ns))
        periods = 1
        while periods < asked and not stopping():
            elapsed_ns = self._tick(ticker).monotonic_ns - first.monotonic_ns
            periods = min(asked, round(elapsed_ns / settings.period_ns) + 1)
            self.left_seconds = (asked - periods) * settings.period_ns * 1e-9
        return start_ns, start_ns + periods * settings.period_ns

    def drain(self, stopping: Callable[[], bool]) -> None:
        """Exchange small messages until no stamp is missing or no new stamp arrives."""
        self.near.draining = True
        ticker = _make_ticker(_DRAIN_PERIOD_NS)
        begun_ns = ticker.due_ns
        while not self.near.complete and not stopping():
            now_ns = self._tick(ticker).monotonic_ns
            quiet_ns = now_ns - max(begun_ns, self.near.last_news_ns)
            if quiet_ns > _QUIET_NS or now_ns - begun_ns > DRAIN_SECONDS * 1e9:
                break

    def _tick(self, ticker: Ticker) -> Instant:
        sleep_until(ticker.due_ns)
        now = Instant.now()
        self._publisher.publish(self.near.message(now))
        self._arrivals.read_until(ticker.due_ns + ticker.period_ns, self._read)
        ticker.next(Instant.now().monotonic_ns)
        return now

    def _unanswered(self, endpoint: str) -> str:
        refused = self.near.refused
        if refused["session"]:
            return f"the far end at {endpoint} is busy with another recording; try again after it"
        if refused.total_refused:
            return (
                f"expected the far end of a recording at {endpoint}, got another program (refused "
                f"{dict(refused)}); start there, in place of the edge: {START_FAR}"
            )
        return (
            f"expected an answer from {endpoint} within {CONNECT_SECONDS:g} s, got none; start "
            f"there, in place of the edge and under the same --name: {START_FAR}"
        )


class FarLoop:
    """The loop of a far end, which serves recordings, one after the other."""

    def __init__(self, far: FarEnd, publisher: Publisher, say: Callable[[str], None]) -> None:
        self.far = far
        self._publisher = publisher
        self._say = say
        self._arrivals = Arrivals(read=None)

    def receive(self, delivery: Delivery) -> None:
        """Take in a message from the near end; called on the bus's thread."""
        self._arrivals.put(delivery)

    def _read(self, arrival: Arrival) -> None:
        self.far.take(arrival.data, arrival.now)

    def run(self, stopping: Callable[[], bool]) -> None:
        """Serve recordings until `stopping()`."""
        while not stopping():
            self._arrivals.arrived.wait(_IDLE_SECONDS)
            self._arrivals.arrived.clear()
            self._arrivals.read_until(Instant.now().monotonic_ns + _DRAIN_PERIOD_NS, self._read)
            if self.far.owes_version:
                self.far.owes_version = False
                self._publisher.publish(version_notice())
                self._say("refused a recorder of another version of this project")
            if self.far.recording is not None:
                self._serve(self.far.recording, stopping)

    def _serve(self, recording: FarRecording, stopping: Callable[[], bool]) -> None:
        settings = recording.settings
        self._say(
            f"recording {recording.session:08x}: {1e9 / settings.period_ns:g} messages a second, "
            f"{settings.uplink_bytes} B up, {settings.downlink_bytes} B down"
        )
        ticker = _make_ticker(settings.period_ns)
        draining = False
        while not stopping():
            sleep_until(ticker.due_ns)
            now = Instant.now()
            if recording.over(now):
                self.far.end()
            if self.far.recording is not recording:
                break
            self._publisher.publish(recording.message(now))
            self._arrivals.read_until(ticker.due_ns + ticker.period_ns, self._read)
            if recording.draining and not draining:
                draining, ticker = True, _make_ticker(_DRAIN_PERIOD_NS)
            ticker.next(Instant.now().monotonic_ns)
        missed = recording.unreported + self._arrivals.missed
        unreported = f", {missed} not reported" if missed else ""
        self._say(
            f"recording {recording.session:08x} over: {recording.received} received{unreported}, "
            f"{recording.sent} sent"
        )


def _make_ticker(period_ns: int) -> Ticker:
    return Ticker(start_ns=Instant.now().monotonic_ns, period_ns=period_ns, max_backlog_ns=0)
