"""The last seconds of the link: the age of the answer in use, the delays, and the outages."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from shared.telemetry.outages import OUTAGE, Change, LinkLane
from shared.telemetry.schema import Schema

SPAN_NS = 20_000_000_000
BUCKET_NS = 100_000_000
# Rows of the link may come this much later than the robot's rows of the same time.
_PATIENCE_NS = 500_000_000
_DIRECTIONS = ("up", "down")
# Outages that the strip keeps; more of them look like one.
_MAX_OUTAGES = 200


class Strip:
    """Takes in rows of the robot and of the link, and keeps the last `SPAN_NS`."""

    def __init__(self) -> None:
        self._now_ns: int | None = None
        # The number of each bucket, and its largest age [ms].
        self._ages: deque[tuple[int, float]] = deque(maxlen=SPAN_NS // BUCKET_NS)
        # The robot sends all the time; the edge may have nothing to send.
        self._lanes = (LinkLane(steady=True), LinkLane())
        self._delays_ms: list[float | None] = [None, None]
        # The beginning and the end of each outage [ns]; the end of one that lasts is None.
        self._outages: tuple[deque[list[int | None]], ...] = tuple(
            deque(maxlen=_MAX_OUTAGES) for _ in _DIRECTIONS
        )

    def take_ticks(self, schema: Schema, rows: np.ndarray) -> None:
        """Take in rows of the robot, in order."""
        wall_ns = schema.column(rows, "wall_ns").astype(np.int64)
        self._now_ns = int(wall_ns[-1])
        age_ns = schema.column(rows, "projector_age_ns")
        known = age_ns >= 0
        for bucket in np.unique(wall_ns[known] // BUCKET_NS).tolist():
            inside = known & (wall_ns // BUCKET_NS == bucket)
            age_ms = float(age_ns[inside].max()) * 1e-6
            if self._ages and self._ages[-1][0] == bucket:
                age_ms = max(age_ms, self._ages.pop()[1])
            self._ages.append((bucket, round(age_ms, 2)))
        silence = self._lanes[0].silent(self._now_ns, OUTAGE, patience_ns=_PATIENCE_NS)
        self._change(0, silence)

    def take_link(self, schema: Schema, rows: np.ndarray) -> None:
        """Take in rows of the link, in order."""
        directions = schema.column(rows, "direction")
        for direction, lane in enumerate(self._lanes):
            way = rows[directions == direction]
            if not len(way):
                continue
            took_ns = schema.column(way, "achieved_ns").astype(np.int64)
            sent_ns = schema.column(way, "wall_ns").astype(np.int64)
            self._change(direction, lane.add(sent_ns, took_ns) + lane.lasting())
            last_ns = int(took_ns[-1])
            self._delays_ms[direction] = round(last_ns * 1e-6, 2) if last_ns >= 0 else None

    def newest(self) -> dict[str, Any]:
        """Return the strip for the page, with times in seconds before the robot's newest row.

        `ages` are pairs of a time and an age [ms]. `outages` has for each direction pairs of a
        beginning and an end; the end of a lasting outage is 0. `delays_ms` are those of the last
        messages, None if there is none or it is lost.
        """
        now_ns = self._now_ns
        if now_ns is None:
            return {"ages": [], "outages": {}, "delays_ms": {}}
        oldest = (now_ns - SPAN_NS) // BUCKET_NS
        return {
            "ages": [
                [round((bucket * BUCKET_NS - now_ns) * 1e-9, 2), age_ms]
                for bucket, age_ms in self._ages
                if bucket > oldest
            ],
            "outages": {
                name: [
                    [_before(begin, now_ns), _before(end, now_ns)]
                    for begin, end in outages
                    if end is None or end > now_ns - SPAN_NS
                ]
                for name, outages in zip(_DIRECTIONS, self._outages, strict=True)
            },
            "delays_ms": dict(zip(_DIRECTIONS, self._delays_ms, strict=True)),
        }

    def _change(self, direction: int, changes: list[Change]) -> None:
        outages = self._outages[direction]
        for at_ns, state in sorted(changes):
            if state == OUTAGE:
                outages.append([at_ns, None])
            elif outages and outages[-1][1] is None:
                outages[-1][1] = at_ns


def _before(at_ns: int | None, now_ns: int) -> float:
    """Return a time before now [s], negative, not before the strip begins; None is now."""
    since_ns = 0 if at_ns is None else at_ns - now_ns
    return round(max(since_ns, -SPAN_NS) * 1e-9, 2)
