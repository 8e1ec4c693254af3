"""The part of the link that a run has met: its outages, in the time of the task.

The shim's rows tell when messages were sent and released. A message under way at the end has no
row: an outage that lasts until then is known by the lack of arrivals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from shared.telemetry.metrics import in_task
from shared.telemetry.outages import OUTAGE, LinkLane
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, Schema

DIRECTIONS = ("uplink", "downlink")
# Shorter outages are jitter, and no controller falls because of them.
LEAST_NS = 10_000_000
_PERIOD_NS = 1_000_000


@dataclass(frozen=True)
class MetOutage:
    """An outage of a direction, in the time of the task [ns]. `over`: it ended within the run."""

    direction: str
    begin_ns: int
    end_ns: int
    over: bool

    @property
    def duration_ns(self) -> int:
        """The part of the outage within the run [ns]."""
        return self.end_ns - self.begin_ns

    def in_words(self) -> str:
        """Return the direction, the beginning in the run, and the duration."""
        end = f"for {self.duration_ns * 1e-9:.2f} s" if self.over else "that was not over"
        return f"{self.direction} from {self.begin_ns * 1e-9:.2f} s on {end}"


@dataclass(frozen=True)
class LinkMet:
    """The outages within the task.

    The task begins `task_begins_ns` after the first message, and lasts `lasted_ns` in real time.
    """

    outages: tuple[MetOutage, ...]
    task_begins_ns: int
    lasted_ns: int

    @property
    def worst(self) -> MetOutage | None:
        """The longest outage; None without one."""
        return max(self.outages, key=lambda each: each.duration_ns, default=None)


def link_met(
    schema: Schema, rows: np.ndarray, link_rows: np.ndarray, solve_rows: np.ndarray, *, steady: bool
) -> LinkMet | None:
    """Return the part of the link that a run has met; None without a task or without messages.

    `rows` are the robot's, `link_rows` the shim's, `solve_rows` the edge's. `steady`: the edge
    answers every state that it can, so that a lost answer is an outage.
    """
    rows = in_task(schema, rows)
    if not len(rows) or not len(link_rows):
        return None
    wall_ns = schema.column(rows, "wall_ns")
    begun_ns, ended_ns = int(wall_ns[0]), int(wall_ns[-1]) + _PERIOD_NS
    answers_ns = SOLVE_SCHEMA.column(solve_rows, "wall_ns").astype(np.int64)
    found = []
    for direction, name in enumerate(DIRECTIONS):
        way = link_rows[LINK_SCHEMA.column(link_rows, "direction") == direction]
        sent_ns = LINK_SCHEMA.column(way, "wall_ns").astype(np.int64)
        delay_ns = LINK_SCHEMA.column(way, "achieved_ns").astype(np.int64)
        lane = LinkLane(steady=steady or direction == 0, longer_than_ns=LEAST_NS)
        spans = [*_outages(lane, sent_ns, delay_ns)]
        passed = delay_ns >= 0
        if passed.any():
            pending_ns = ended_ns
            if direction == 0:
                pending_ns = int(sent_ns[passed].max()) + _PERIOD_NS
            elif (later := answers_ns > sent_ns[passed].max()).any():
                pending_ns = int(answers_ns[later].min())
            last_ns = int((sent_ns + delay_ns)[passed].max())
            spans.append((max(last_ns, pending_ns + int(delay_ns[passed].min())), ended_ns + 1))
        for begin_ns, end_ns in spans:
            begin_ns, over = max(begin_ns, begun_ns), end_ns <= ended_ns
            end_ns = min(end_ns, ended_ns)
            if end_ns - begin_ns > LEAST_NS:
                found.append(MetOutage(name, begin_ns - begun_ns, end_ns - begun_ns, over))
    first_ns = int(LINK_SCHEMA.column(link_rows, "wall_ns").min())
    return LinkMet(tuple(found), begun_ns - first_ns, ended_ns - begun_ns)


def _outages(
    lane: LinkLane, sent_ns: np.ndarray, delay_ns: np.ndarray
) -> Iterator[tuple[int, int]]:
    """Yield the outages that have ended, from their beginning to their end [ns]."""
    order = np.argsort(sent_ns, kind="stable")
    begin_ns = None
    for at_ns, state in lane.add(sent_ns[order], delay_ns[order]):
        if state == OUTAGE:
            begin_ns = at_ns
        elif begin_ns is not None:
            yield begin_ns, at_ns
            begin_ns = None
