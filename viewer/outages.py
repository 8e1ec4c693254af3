"""When a direction of the link stalls, from the messages that came through.

A message that left the queue alone would have needed the least delay seen so far. What it took
beyond that, and beyond the arrival before it, nothing came out of the link:

    outage = [max(arrival before, sent + least delay), arrival]    if longer than `OUTAGE_NS`

A constant delay, however large, is none, nor is a sender that has nothing to say. A link that was
cut shows in what is missing: see `LinkLane.silent`.
"""

from __future__ import annotations

import numpy as np

OUTAGE_NS = 50_000_000

PASSING, OUTAGE, SILENT = "passing", "outage", "nothing sent"
Change = tuple[int, str]


class LinkLane:
    """States of one direction, as changes (instant [ns], state); instants are not in order."""

    def __init__(self) -> None:
        self.last_arrival_ns: int | None = None
        self._least_ns = np.iinfo(np.int64).max
        self._silent = False

    def add(self, sent_ns: np.ndarray, delay_ns: np.ndarray) -> list[Change]:
        """The changes that messages tell; a negative delay is a lost message."""
        passed = delay_ns >= 0
        sent_ns, delay_ns = sent_ns[passed], delay_ns[passed]
        if not len(sent_ns):
            return []
        arrival_ns = sent_ns + delay_ns
        order = np.argsort(arrival_ns, kind="stable")
        sent_ns, delay_ns, arrival_ns = sent_ns[order], delay_ns[order], arrival_ns[order]
        changes: list[Change] = []
        if self.last_arrival_ns is None or self._silent:
            changes.append((int(arrival_ns[0]), PASSING))
            self._silent = False
        first = arrival_ns[0] if self.last_arrival_ns is None else self.last_arrival_ns
        least_ns = np.minimum(np.minimum.accumulate(delay_ns), self._least_ns)
        begin_ns = np.maximum(np.append(first, arrival_ns[:-1]), sent_ns + least_ns)
        for k in np.flatnonzero(arrival_ns - begin_ns > OUTAGE_NS):
            changes += [(int(begin_ns[k]), OUTAGE), (int(arrival_ns[k]), PASSING)]
        self.last_arrival_ns = int(arrival_ns[-1])
        self._least_ns = int(least_ns[-1])
        return changes

    def silent(self, now_ns: int, state: str, *, patience_ns: int) -> list[Change]:
        """The change to `state` when nothing has come out for `patience_ns`; once per silence."""
        last = self.last_arrival_ns
        if last is None or self._silent or now_ns - last <= patience_ns:
            return []
        self._silent = True
        return [(last, state)]
