"""When a direction of the link stalls, from the messages that came through.

A message that left the queue alone would have needed the least delay seen so far. What it took
beyond that, and beyond the arrival before it, nothing came out of the link:

    outage = [max(arrival before, sent + least delay), arrival]    if longer than `OUTAGE_NS`

A constant delay, however large, is none, nor is a sender that has nothing to say. Of a sender that
is `steady` a lost message should have come out too: `sent` is then that of the first one after the
arrival before, lost or not. A link that was cut shows in what is missing: see `LinkLane.silent`.
"""

from __future__ import annotations

import numpy as np

OUTAGE_NS = 50_000_000

PASSING, OUTAGE, SILENT = "passing", "outage", "nothing sent"
Change = tuple[int, str]


class LinkLane:
    """States of one direction, as changes (instant [ns], state); instants are not in order."""

    def __init__(self, *, steady: bool = False) -> None:
        self.last_arrival_ns: int | None = None
        self._steady = steady
        self._least_ns = np.iinfo(np.int64).max
        # When the first message was lost since the last arrival.
        self._lost_ns: int | None = None
        self._silent: str | None = None

    def add(self, sent_ns: np.ndarray, delay_ns: np.ndarray) -> list[Change]:
        """The changes that messages tell; a negative delay is a lost message."""
        owed_ns = self._owed(sent_ns, delay_ns) if self._steady else sent_ns
        passed = delay_ns >= 0
        owed_ns, sent_ns, delay_ns = owed_ns[passed], sent_ns[passed], delay_ns[passed]
        if not len(sent_ns):
            return []
        arrival_ns = sent_ns + delay_ns
        order = np.argsort(arrival_ns, kind="stable")
        owed_ns, delay_ns, arrival_ns = owed_ns[order], delay_ns[order], arrival_ns[order]
        changes: list[Change] = []
        if self.last_arrival_ns is None or self._silent is not None:
            changes.append((int(arrival_ns[0]), PASSING))
        first = arrival_ns[0] if self.last_arrival_ns is None else self.last_arrival_ns
        least_ns = np.minimum(np.minimum.accumulate(delay_ns), self._least_ns)
        begin_ns = np.maximum(np.append(first, arrival_ns[:-1]), owed_ns + least_ns)
        if self._silent == OUTAGE:
            # That one is known.
            begin_ns[0] = arrival_ns[0]
        for k in np.flatnonzero(arrival_ns - begin_ns > OUTAGE_NS):
            changes += [(int(begin_ns[k]), OUTAGE), (int(arrival_ns[k]), PASSING)]
        self.last_arrival_ns = int(arrival_ns[-1])
        self._least_ns = int(least_ns[-1])
        self._silent = None
        return changes

    def silent(self, now_ns: int, state: str, *, patience_ns: int) -> list[Change]:
        """The change to `state` when nothing has come out for `patience_ns`; once per silence."""
        last = self.last_arrival_ns
        if last is None or self._silent is not None or now_ns - last <= patience_ns:
            return []
        self._silent = state
        return [(last, state)]

    def _owed(self, sent_ns: np.ndarray, delay_ns: np.ndarray) -> np.ndarray:
        """Since when [ns] (n,) something should have come out, where messages have; they are in the
        order of sending but for lost ones, which are known before those that are under way.
        """
        lost_ns = self._lost_ns
        if lost_ns is None and np.all(delay_ns >= 0):
            return sent_ns
        owed_ns = sent_ns.copy()
        for k in np.argsort(sent_ns, kind="stable"):
            if delay_ns[k] < 0:
                lost_ns = int(sent_ns[k]) if lost_ns is None else min(lost_ns, int(sent_ns[k]))
            elif lost_ns is not None and lost_ns < sent_ns[k]:
                owed_ns[k], lost_ns = lost_ns, None
        self._lost_ns = lost_ns
        return owed_ns
