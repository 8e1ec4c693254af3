"""The interface between a node and a bus, and the counts of messages on the way.

Every message carries an `Envelope` outside its payload: its sender, its number, and its time of
sending. That is enough to count losses and to delay a message from the moment it was sent, without
reading the payload.
"""

from __future__ import annotations

import secrets
import struct
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

# The name of a thread that closes a session.
CLOSING = "bus-close"
_ENVELOPE = struct.Struct("<IIqI")
# No publisher sends more often than a robot ticks.
_PERIOD_NS = 1_000_000
# More than the variation of one-way delays.
_AHEAD_NS = 1_000_000_000


class Envelope(NamedTuple):
    """The sender, number and time of a message.

    `session` tells one publisher from another, and `sequence` counts its messages. `sent_ns` is the
    publisher's clock when it sent. `clock` identifies that clock, because machines have different
    ones.
    """

    session: int
    sequence: int
    sent_ns: int
    clock: int

    def encode(self) -> bytes:
        """Return the envelope as twenty bytes."""
        return _ENVELOPE.pack(*self)

    @staticmethod
    def decode(data: bytes | None) -> Envelope | None:
        """Return the envelope; None if the bytes are not one."""
        if data is None or len(data) != _ENVELOPE.size:
            return None
        return Envelope(*_ENVELOPE.unpack(data))


class Delivery(NamedTuple):
    """A message as it arrived.

    `on_plans`: it arrived on the key of plans. Plans go in the direction of answers, on a key of
    their own.
    """

    data: bytes
    envelope: Envelope | None
    on_plans: bool = False


class Publisher(Protocol):
    """Publishes on one key. Without a subscriber it neither blocks nor raises."""

    sent: int

    def publish(self, data: bytes) -> None:
        """Send a new message."""
        ...

    def forward(self, delivery: Delivery) -> None:
        """Send a received message on, with its own envelope."""
        ...


def new_session() -> int:
    """A random identity for one start of a publisher."""
    return secrets.randbits(32)


@dataclass(slots=True)
class _Span:
    """The numbers of a publisher from the first one on, and the arrivals among them.

    `lead_ns` is the largest lead of the publisher's numbers over the receiver's clock.
    """

    first: int
    last: int
    lead_ns: int
    arrived: int = 1

    @property
    def lost(self) -> int:
        """The number of sequence numbers missing between the first and the last one."""
        return max(0, self.last - self.first + 1 - self.arrived)


class ReceptionCounter:
    """Received and lost messages of one key, by the sequence numbers of each publisher.

    A message that arrives out of order is not lost; a number that never arrives is. Numbers cannot
    run ahead of the receiver's clock. At a number that does by more than a second, and at one that
    is as far before the first, the span of its publisher begins anew. So a forged number is not
    taken for losses. Of more than a thousand publishers only the first ones have their losses
    counted.
    """

    _MAX_PUBLISHERS = 1024

    def __init__(self) -> None:
        self.received = 0
        self._spans: dict[int, _Span] = {}
        # The losses within the spans that have ended.
        self._lost = 0

    def count(self, envelope: Envelope | None, now_ns: int) -> None:
        """Count an arrival at a time of the receiver's clock."""
        self.received += 1
        if envelope is None:
            return
        sequence, span = envelope.sequence, self._spans.get(envelope.session)
        lead_ns = sequence * _PERIOD_NS - now_ns
        if span is not None:
            before_ns = (span.first - sequence) * _PERIOD_NS
            if max(lead_ns - span.lead_ns, before_ns) <= _AHEAD_NS:
                span.first, span.last = min(span.first, sequence), max(span.last, sequence)
                span.lead_ns = max(span.lead_ns, lead_ns)
                span.arrived += 1
                return
            self._lost += span.lost
        elif len(self._spans) >= self._MAX_PUBLISHERS:
            return
        self._spans[envelope.session] = _Span(sequence, sequence, lead_ns)

    @property
    def lost(self) -> int:
        """The number of sequence numbers missing between the first and the last one of each span of
        a publisher.
        """
        return self._lost + sum(span.lost for span in self._spans.values())


class SenderCounter:
    """Taken and refused messages by their publisher; of more than sixty, the first have a name."""

    _MAX_SENDERS = 60

    def __init__(self) -> None:
        self._counts: dict[int, list[int]] = {}
        self._others = [0, 0]

    def count(self, envelope: Envelope | None, *, taken: bool) -> None:
        """Count a message."""
        counts = self._others
        if envelope is not None:
            found = self._counts.get(envelope.session)
            if found is not None:
                counts = found
            elif len(self._counts) < self._MAX_SENDERS:
                counts = self._counts[envelope.session] = [0, 0]
        counts[not taken] += 1

    @property
    def by_sender(self) -> dict[str, dict[str, int]]:
        """`taken` and `refused` by the sender's name; `others` are those without one."""
        named = {sender_name(session): counts for session, counts in self._counts.items()}
        if any(self._others):
            named["others"] = self._others
        return {
            name: {"taken": taken, "refused": refused} for name, (taken, refused) in named.items()
        }


def sender_name(session: int) -> str:
    """Return the name of a publisher in reports: its session in hexadecimal digits."""
    return f"{session:08x}"


class Inbox:
    """Holds the newest message of each publisher since the last `take`.

    `put` runs on the bus's thread, the other methods on the node's. At the end of an outage
    hundreds of messages arrive at once: all are counted, and the node works on the newest. Messages
    without an envelope come from other programs. A bounded number of them is kept, so that the node
    refuses and counts them. Inboxes with one `arrived` can be waited for together. `now_ns` reads
    the receiver's clock [ns].
    """

    _MAX_PUBLISHERS = 8
    _MAX_STRANGERS = 8

    def __init__(
        self,
        arrived: threading.Event | None = None,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.counter = ReceptionCounter()
        self._now_ns = now_ns
        self._newest: dict[int, Delivery] = {}
        self._strangers: deque[Delivery] = deque(maxlen=self._MAX_STRANGERS)
        self._lock = threading.Lock()
        self._arrived = threading.Event() if arrived is None else arrived

    def put(self, delivery: Delivery) -> None:
        """Count a message and hold it."""
        envelope = delivery.envelope
        with self._lock:
            self.counter.count(envelope, self._now_ns())
            if envelope is None:
                self._strangers.append(delivery)
            else:
                held = self._newest.get(envelope.session)
                if held is None and len(self._newest) >= self._MAX_PUBLISHERS:
                    return
                if (
                    held is None
                    or held.envelope is None
                    or envelope.sequence > held.envelope.sequence
                ):
                    self._newest[envelope.session] = delivery
        self._arrived.set()

    def take(self) -> list[Delivery]:
        """Return the messages held since the last call."""
        self._arrived.clear()
        if not self._newest and not self._strangers:
            return []
        with self._lock:
            taken = [*self._strangers, *self._newest.values()]
            self._strangers.clear()
            self._newest.clear()
        return taken

    @property
    def holds(self) -> bool:
        """Return whether a message can be taken."""
        return bool(self._newest) or bool(self._strangers)

    def wait(self, timeout_ns: int) -> bool:
        """Wait for an arrival; return False if none came in time."""
        return self._arrived.wait(timeout_ns * 1e-9)


class RefusalCounter(Counter[str]):
    """Counts of refused messages, by the name of the check that failed."""

    @property
    def total_refused(self) -> int:
        return sum(self.values())
