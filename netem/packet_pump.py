"""Move IP packets between the two ends of a link, each after the delay at its sending time.

This shim works below the transport: it sees packets, not messages. Fragmentation, loss of one
fragment, retransmission, head-of-line blocking and full queues are therefore real. The sending time
of a packet is the time at which the pump reads it. A direction holds a limited number of bytes. A
packet that finds no room is dropped (drop-tail).
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Sequence

import numpy as np

from netem.delay_line import DelayLine
from shared.errors import LinkError

# Packets of one direction that are read, and written, before the turn of the other direction. A
# burst one way must not hold the other back for long.
_BATCH = 32
_IDLE_SECONDS = 0.1


class Lateness:
    """Histogram of the lateness of packets, in bins of 10 µs up to 0.1 s, of constant size."""

    _BIN_NS = 10_000

    def __init__(self) -> None:
        self._counts = [0] * 10_000
        self.max_ns = 0

    def add(self, late_ns: int) -> None:
        """Count one packet that left `late_ns` after it was due."""
        self._counts[min(late_ns // self._BIN_NS, len(self._counts) - 1)] += 1
        self.max_ns = max(self.max_ns, late_ns)

    def quantile_ms(self, fraction: float) -> float:
        """Upper edge of the bin in which the quantile lies [ms]; 0 if nothing was counted."""
        counts = np.cumsum(self._counts)
        if counts[-1] == 0:
            return 0.0
        return float((np.searchsorted(counts, fraction * counts[-1]) + 1) * self._BIN_NS * 1e-6)


class Way:
    """One direction: packets read at one descriptor are written to another when they are due.

    `full` counts packets that found no room in `queue_bytes`. `refused` counts packets that the
    device at the other end did not accept.
    """

    def __init__(
        self,
        line: DelayLine[bytes],
        *,
        source: int,
        target: int,
        queue_bytes: int,
        packet_bytes: int,
    ) -> None:
        self.line = line
        self.source = source
        self.lateness = Lateness()
        self.packets = self.bytes = self.full = self.refused = 0
        self._target = target
        self._queue_bytes = queue_bytes
        self._packet_bytes = packet_bytes
        self._held_bytes = 0

    def take(self) -> None:
        """Read the packets that were sent, at most a batch; `LinkError` if the device is gone."""
        for _ in range(_BATCH):
            try:
                packet = os.read(self.source, self._packet_bytes)
            except BlockingIOError:
                return
            except OSError as error:
                raise LinkError(
                    f"expected packets from a TUN device, got {error.strerror}; keep its namespace "
                    "until this command has ended"
                ) from None
            now_ns, size = time.monotonic_ns(), len(packet)
            self.packets += 1
            self.bytes += size
            if self._held_bytes + size > self._queue_bytes:
                self.full += 1
            elif self.line.push(packet, sent_ns=now_ns, size=size) is not None:
                self._held_bytes += size

    def release(self) -> None:
        """Write the packets that are due, at most a batch."""
        for due in self.line.pop_due(time.monotonic_ns(), limit=_BATCH):
            self._held_bytes -= len(due.item)
            try:
                os.write(self._target, due.item)
            except OSError:
                # The device is down or has no room. The packet is lost, as at the end of a cable.
                self.refused += 1
            self.lateness.add(time.monotonic_ns() - due.sent_ns - due.nominal_ns)


def wait_for_packet(sources: Sequence[int], *, stopping: Callable[[], bool]) -> int | None:
    """Wait for a first packet at one of the descriptors. Return the time [ns]; None if stopped."""
    while not stopping():
        if select.select(sources, (), (), _IDLE_SECONDS)[0]:
            return time.monotonic_ns()
    return None


def pump(ways: Sequence[Way], *, stopping: Callable[[], bool]) -> None:
    """Move packets until `stopping()`."""
    sources = [way.source for way in ways]
    while not stopping():
        due = [way.line.next_due_ns for way in ways if way.line.next_due_ns is not None]
        wait = _IDLE_SECONDS
        if due:
            wait = max(0.0, min(wait, (min(due) - time.monotonic_ns()) * 1e-9))
        # Not epoll: its timeout is rounded to whole milliseconds.
        select.select(sources, (), (), wait)
        for way in ways:
            way.take()
            way.release()
