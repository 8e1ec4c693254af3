"""The byte queue before the link, first in, first out, computed at once for messages of one size.

Let A(t) be the bytes that have come by t, and C(s, t) the bytes that the link can carry between s
and t. Then

    D(t) = min over s ≤ t of A(s) + C(s, t)

bytes have left by t. A message that finds no room is lost (drop-tail). `netem.capacity` has the
same queue for messages that come one by one.
"""

from __future__ import annotations

import numpy as np

from netem.profile import LOST


def departures(capacity: np.ndarray, *, message_bytes: float, queue_bytes: float) -> np.ndarray:
    """The time at which the last byte of each message leaves, (n,) [periods].

    A message comes at the beginning of each period. `capacity` (n,) is spread evenly over each
    period [bytes]. The time is inf for a message that is still queued at the end, nan for a loss.
    """
    carried = np.concatenate([[0.0], np.cumsum(capacity)])
    # Message k has left when the link has carried left[k] bytes.
    left = np.full(len(capacity), np.nan)
    last = 0.0
    for k, now in enumerate(carried[:-1].tolist()):
        begin = max(now, last)
        if begin - now + message_bytes <= queue_bytes:
            left[k] = last = begin + message_bytes
    return _when(carried, left)


def delays_ns(departed: np.ndarray, *, base_ns: int, period_ns: int) -> np.ndarray:
    """One-way delays (n,) [ns] from the times of leaving [periods]; `LOST` for inf and nan."""
    passed = np.isfinite(departed)
    queued = np.where(passed, departed, 0.0) - np.arange(len(departed))
    return np.where(passed, np.rint(queued * period_ns) + base_ns, LOST).astype(np.int64)


def _when(carried: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The first time by which the link has carried `wanted` bytes [periods].

    It is inf if that never happens, and nan for nan.
    """
    above = np.clip(np.searchsorted(carried, wanted), 1, len(carried) - 1)
    rise = carried[above] - carried[above - 1]
    part = np.divide(wanted - carried[above - 1], rise, out=np.zeros(len(wanted)), where=rise > 0)
    times = np.where(wanted > carried[-1], np.inf, above - 1 + part)
    return np.where(np.isnan(wanted), np.nan, times)
