"""Lead of the far machine's clock over the near machine's, from messages both ways.

A message up leaves at s by the near clock and arrives at x by the far one. A message down leaves at
x by the far clock and arrives at r by the near one. With θ(x) the lead of the far clock,

    x − s = θ(x) + delay up          x − r = θ(x) − delay down

so θ lies below every x − s and above every x − r (the four time stamps of NTP, RFC 5905). Clocks
drift, so θ is a line a + b x between the two clouds. The estimate is the line farthest from both,

    f(b) = ½ [ min (x − s − b x) + min (r − x + b x) ]  →  max

f is half the least round trip. It is also the uncertainty, because the clocks of the ends cannot
tell how the round trip divides into up and down. The estimate assumes halves. On a path with
unequal least delays one direction then looks up to f slower, and the other up to f faster.

f is concave and piecewise linear. Its corners are slopes of the clouds' convex hulls, so trying
these slopes is exact (Zhang, Liu, Xia, INFOCOM 2002, on clocks in network measurements).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

NEVER = -1
# A kernel slews a clock by at most this (`adjtimex`), and every quartz is more accurate.
MAX_DRIFT = 500e-6

Hull: TypeAlias = list[tuple[int, int]]


@dataclass(frozen=True)
class Stamps:
    """Time stamps of the messages of one direction, in the order of sending, (n,) int64.

    `sent_ns` is by the sender's clock, `received_ns` by the receiver's. `NEVER` stands for an
    unknown time.
    """

    sent_ns: np.ndarray
    received_ns: np.ndarray

    @property
    def arrived(self) -> Stamps:
        """The stamps of the messages that were received."""
        mask = self.received_ns != NEVER
        return Stamps(self.sent_ns[mask], self.received_ns[mask])


@dataclass(frozen=True)
class ClockOffset:
    """Lead of the far clock: `offset_ns` when it shows `reference_ns`, growing by `drift_ppm`.

    `uncertainty_ns` is None if the machines synchronise their clocks: their accuracy is the bound.
    """

    offset_ns: int
    uncertainty_ns: int | None
    drift_ppm: float
    reference_ns: int
    method: str

    def to_near(self, far_ns: np.ndarray) -> np.ndarray:
        """The time on the near clock when the far clock shows `far_ns`, int64 [ns]."""
        drift_ns = np.rint(1e-6 * self.drift_ppm * (far_ns - self.reference_ns)).astype(np.int64)
        return far_ns - self.offset_ns - drift_ns


def one_clock(reference_ns: int) -> ClockOffset:
    """The offset if both ends read the clock of one machine: 0."""
    return ClockOffset(0, 0, 0.0, reference_ns, "one clock: both ends on one machine")


def synchronised(up: Stamps, down: Stamps) -> ClockOffset | None:
    """The offset if both machines keep one time (PTP, GNSS): 0.

    None if a message arrived before it was sent.
    """
    up, down = up.arrived, down.arrived
    if min(np.min(up.received_ns - up.sent_ns), np.min(down.received_ns - down.sent_ns)) < 0:
        return None
    return ClockOffset(0, None, 0.0, int(up.received_ns[0]), "clocks synchronised by the machines")


def equal_least_delays(up: Stamps, down: Stamps) -> ClockOffset:
    """The offset by the module's equation. At least one message of each direction must have
    arrived.
    """
    up, down = up.arrived, down.arrived
    reference_ns = int(up.received_ns[0])
    lead_ns = int(up.received_ns[0] - up.sent_ns[0])
    above = _lower_hull(
        up.received_ns - reference_ns,
        up.received_ns - up.sent_ns - lead_ns,
    )
    # The upper hull of the lower cloud is the lower hull of its negative.
    below = _lower_hull(
        down.sent_ns - reference_ns,
        down.received_ns - down.sent_ns + lead_ns,
    )
    slopes = np.concatenate([_edge_slopes(above), -_edge_slopes(below), [0.0]])
    slopes = np.unique(np.clip(slopes, -MAX_DRIFT, MAX_DRIFT))
    to_above = _least_after_drift(above, slopes)
    to_below = _least_after_drift(below, -slopes)
    margins = to_above + to_below
    # Among slopes that are equally good to the nanosecond, take the slowest drift.
    good = np.flatnonzero(margins >= margins.max() - 1.0)
    best = good[np.argmin(np.abs(slopes[good]))]
    return ClockOffset(
        offset_ns=lead_ns + round((to_above[best] - to_below[best]) / 2),
        uncertainty_ns=max(0, round(margins[best] / 2)),
        drift_ppm=float(slopes[best]) * 1e6,
        reference_ns=reference_ns,
        method="equal least delays both ways",
    )


def _lower_hull(x_ns: np.ndarray, y_ns: np.ndarray) -> Hull:
    """Corners of the lower hull from left to right, in exact integers (Andrew's monotone chain)."""
    order = np.lexsort((y_ns, x_ns))
    hull: Hull = []
    for x, y in zip(x_ns[order].tolist(), y_ns[order].tolist(), strict=True):
        if hull and hull[-1][0] == x:
            continue
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (x - x0) * (y1 - y0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


def _edge_slopes(hull: Hull) -> np.ndarray:
    corners = np.array(hull, dtype=float)
    return np.diff(corners[:, 1]) / np.diff(corners[:, 0])


def _least_after_drift(hull: Hull, slopes: np.ndarray) -> np.ndarray:
    """The minimum of y − b x over the corners, for each slope b, (n_slopes,) [ns]."""
    x, y = np.array(hull, dtype=float).T
    least: np.ndarray = np.min(y[None, :] - slopes[:, None] * x[None, :], axis=1)
    return least
