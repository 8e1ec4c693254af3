"""Outages of a direction of the link, from the messages that came through.

Without a queue, a message would arrive after the least delay seen so far. From this time, or from
the previous arrival if that is later, until its arrival no message comes out of the link:

    outage = [max(arrival before, sent + least delay), arrival]    if longer than a limit

A constant delay of any length is no outage, and neither is a sender's pause. If a sender is
`steady`, a lost message should have come out too. Then `sent` is the time of the first message sent
after the previous arrival, lost or not. `LinkLane.silent` finds a link that was cut, by the lack of
messages, and `LinkLane.lasting` by the losses, before it passes a message again.
"""

from __future__ import annotations

import numpy as np

OUTAGE_NS = 50_000_000

PASSING, OUTAGE, SILENT = "passing", "outage", "nothing sent"
Change = tuple[int, str]


class LinkLane:
    """The states of one direction, as changes (instant [ns], state). Instants are not in order.

    An outage lasts longer than `longer_than_ns`.
    """

    def __init__(self, *, steady: bool = False, longer_than_ns: int = OUTAGE_NS) -> None:
        self.last_arrival_ns: int | None = None
        self._steady = steady
        self._longer_than_ns = longer_than_ns
        self._least_ns = np.iinfo(np.int64).max
        # When the first message that was lost since the last arrival was sent.
        self._lost_ns: int | None = None
        self._newest_lost_ns = 0
        self._silent: str | None = None

    def add(self, sent_ns: np.ndarray, delay_ns: np.ndarray) -> list[Change]:
        """Return the changes that messages show; a negative delay is a lost message."""
        owed_ns = self._owed(sent_ns, delay_ns) if self._steady else sent_ns
        passed = delay_ns >= 0
        if not passed.all():
            self._newest_lost_ns = int(sent_ns[~passed].max())
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
            # `silent` has returned this outage already.
            begin_ns[0] = arrival_ns[0]
        for k in np.flatnonzero(arrival_ns - begin_ns > self._longer_than_ns):
            changes += [(int(begin_ns[k]), OUTAGE), (int(arrival_ns[k]), PASSING)]
        self.last_arrival_ns = int(arrival_ns[-1])
        self._least_ns = int(least_ns[-1])
        self._silent = None
        return changes

    def silent(self, now_ns: int, state: str, *, patience_ns: int) -> list[Change]:
        """Return the change to `state` if no message came for `patience_ns`; once per silence."""
        last = self.last_arrival_ns
        if last is None or self._silent is not None or now_ns - last <= patience_ns:
            return []
        self._silent = state
        return [(last, state)]

    def lasting(self) -> list[Change]:
        """Return the change to an outage of a steady sender that lost messages show while it lasts;
        once per outage.
        """
        last, lost_ns = self.last_arrival_ns, self._lost_ns
        if last is None or lost_ns is None or self._silent is not None:
            return []
        begin_ns = max(last, lost_ns + int(self._least_ns))
        if self._newest_lost_ns - begin_ns <= self._longer_than_ns:
            return []
        self._silent = OUTAGE
        return [(begin_ns, OUTAGE)]

    def _owed(self, sent_ns: np.ndarray, delay_ns: np.ndarray) -> np.ndarray:
        """Return when the first message after the previous arrival was sent, lost or not [ns],
        (n,).

        Messages are in the order of sending. Only a lost message may come earlier: its loss is
        known while others are under way.
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
