"""The byte queue before the link, first in, first out, all messages of one size at once.

With A(t) the bytes that have come and C(s, t) what the link can carry between s and t,

    D(t) = min over s ≤ t of A(s) + C(s, t)

bytes have left. A message that finds no room is lost (drop-tail). `netem.capacity` has the same
queue for messages that come one by one.
"""

from __future__ import annotations

import numpy as np

from netem.profile import LOST


def departures(capacity: np.ndarray, *, message_bytes: float, queue_bytes: float) -> np.ndarray:
    """When the last byte of each message leaves, (n,) [periods]; one comes as each period begins.

    `capacity` (n,) is what the link can carry in each period, evenly over it [bytes]. inf: not
    until the end of the last; nan: lost.
    """
    carried = np.concatenate([[0.0], np.cumsum(capacity)])
    # in the link's bytes: message k has left when it has carried so much
    left = np.full(len(capacity), np.nan)
    last = 0.0
    for k, now in enumerate(carried[:-1].tolist()):
        begin = max(now, last)
        if begin - now + message_bytes <= queue_bytes:
            left[k] = last = begin + message_bytes
    return _when(carried, left)


def delays_ns(departed: np.ndarray, *, base_ns: int, period_ns: int) -> np.ndarray:
    """One-way delays (n,) [ns] of messages that left then [periods]; `LOST` if they did not."""
    passed = np.isfinite(departed)
    queued = np.where(passed, departed, 0.0) - np.arange(len(departed))
    return np.where(passed, np.rint(queued * period_ns) + base_ns, LOST).astype(np.int64)


def _when(carried: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The first time by which the link has carried so much [periods]; inf if never, nan for nan."""
    above = np.clip(np.searchsorted(carried, wanted), 1, len(carried) - 1)
    rise = carried[above] - carried[above - 1]
    part = np.divide(wanted - carried[above - 1], rise, out=np.zeros(len(wanted)), where=rise > 0)
    times = np.where(wanted > carried[-1], np.inf, above - 1 + part)
    return np.where(np.isnan(wanted), np.nan, times)
