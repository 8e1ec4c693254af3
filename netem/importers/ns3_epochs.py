"""Sums over epochs, as ns-3 writes them per bearer: PDUs sent, PDUs received and their mean delay.

A PDU received in an epoch may have been sent in an earlier one. In short epochs most are. So the
PDUs received in an epoch of mean delay d belong to the epochs that sent PDUs a time d before. Each
such epoch takes at most the PDUs that it still misses. An epoch that misses all of its PDUs is
lost.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from netem.importers.measured import UNITS_NS, Measured, one_way, ordered, unfinished_note
from netem.importers.ns3_rows import Row, delay_ns
from netem.importers.options import Options
from netem.importers.resample import check_span
from netem.importers.source import nanoseconds, whole, wrong
from shared.errors import ProfileError

_S = UNITS_NS["s"]
# The maximum number of epochs that wait for their PDUs.
_WAITING = 500


@dataclass
class _Epoch:
    """An epoch [ns]. `arrived` of its PDUs arrived; `waited` is the sum of their delays [ns]."""

    start: int
    end: int
    sent: int
    received: int
    delay: int
    arrived: int = 0
    waited: int = 0

    def take(self, count: int, delay: int) -> int:
        """Let up to `count` of its PDUs arrive with this delay [ns]. Return the number left."""
        taken = min(count, self.sent - self.arrived)
        self.arrived += taken
        self.waited += taken * delay
        return count - taken


def read_epochs(path: Path, rows: Iterable[Row], options: Options, direction: int) -> Measured:
    """The delay of each epoch in which data were sent. `ProfileError` names the wrong line."""
    bearers: dict[str, list[_Epoch]] = defaultdict(list)
    for row in rows:
        bearers[row.cells[2]].append(_epoch(path, row))
    for epochs in bearers.values():
        _match(epochs)
    every = [epoch for epochs in bearers.values() for epoch in epochs if epoch.sent]
    if not every:
        raise ProfileError(f"{path}: expected epochs in which data were sent, got none")
    end = max(epoch.end for epochs in bearers.values() for epoch in epochs)
    longest = max((epoch.delay for epoch in every), default=0)
    known = [epoch for epoch in every if epoch.arrived or epoch.start + longest < end]
    unfinished = sum(epoch.sent for epoch in every) - sum(epoch.sent for epoch in known)
    check_span(path, sum(epoch.end - epoch.start for epoch in known), options.period_ns)
    pieces = []
    for epoch in known:
        times = np.arange(epoch.start, epoch.end, options.period_ns)
        delay = epoch.waited // epoch.arrived if epoch.arrived else 0
        pieces.append((times, np.full(len(times), delay), np.full(len(times), not epoch.arrived)))
    way = ordered(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))
    sent = sum(epoch.sent for epoch in known)
    # Some PDUs of the last epochs may still be under way.
    missing = sum(epoch.sent - epoch.arrived for epoch in known if epoch.end + longest <= end)
    return one_way(
        direction,
        replace(way, counts=(sent, missing)),
        f"{path.name}: means over epochs: an outage shorter than an epoch is smoothed away, and a "
        "loss shows only if a whole epoch was lost; per packet: AggregatedStats=false",
        *unfinished_note(unfinished),
    )


def _epoch(path: Path, row: Row) -> _Epoch:
    where, cells = row
    start, end = (nanoseconds(cell, _S, path, where, "a time in s") for cell in cells[:2])
    if end <= start:
        raise wrong(path, where, "an end after the start", f"{cells[0]} … {cells[1]}")
    sent, received = (
        whole(cell, path, where, "a count of PDUs", low=0, high=10**12) for cell in cells[3:5]
    )
    delay = delay_ns(cells[5], _S, path, where, "a delay in s")
    return _Epoch(start, end, sent, received, delay)


def _match(epochs: list[_Epoch]) -> None:
    """Assign the PDUs received to the epochs in which they were sent."""
    epochs.sort(key=lambda epoch: epoch.start)
    waiting: deque[_Epoch] = deque(maxlen=_WAITING)
    for epoch in epochs:
        if epoch.sent:
            waiting.append(epoch)
        left, middle = epoch.received, (epoch.start + epoch.end) // 2 - epoch.delay
        if not left:
            continue
        for other in sorted(waiting, key=lambda each: _distance(each, middle)):
            left = other.take(left, epoch.delay)
            if not left:
                break
        if left:
            # The PDUs left over were sent before the record began.
            epoch.sent += left
            epoch.take(left, epoch.delay)
        waiting = deque((each for each in waiting if each.arrived < each.sent), maxlen=_WAITING)


def _distance(epoch: _Epoch, time: int) -> int:
    """The distance of a time from an epoch [ns]; 0 within it."""
    return max(epoch.start - time, time - epoch.end, 0)
