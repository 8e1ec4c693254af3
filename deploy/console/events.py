"""The events of a run, from its telemetry: pushes, and outages of the link.

Blocks of rows arrive on the bus's threads; the thread that prints calls `take`. The robot itself
prints its reactions, such as a joint hold.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from shared.output.fall import force_in_words
from shared.output.link_met import DIRECTIONS
from shared.telemetry.outages import OUTAGE, Change, LinkLane
from shared.telemetry.schema import Schema

# An outage of at least TOLD_NS gets a line when it ends. One of more than _SAID_NS also gets a line
# while it lasts. A shorter time is not enough: the shim's rows come in blocks, and late on a busy
# machine.
TOLD_NS = 150_000_000
_SAID_NS = 500_000_000
_UP = 0


@dataclass(frozen=True)
class Event:
    """An event in words, and the name of its service."""

    name: str
    text: str


class Events:
    """The events of a run, and lists of its pushes and outages."""

    def __init__(self) -> None:
        self.pushes: list[str] = []
        self.outages_ns: tuple[list[int], list[int]] = ([], [])
        self._new: deque[Event] = deque()
        self._pushed = False
        # The robot sends all the time; answers may be rare.
        self._lanes = (LinkLane(steady=True), LinkLane())
        # Beginning of an uplink outage that has been announced while it lasts.
        self._open_since_ns: int | None = None
        # Task time minus the machine's clock; None before the task begins.
        self._offset_ns: int | None = None
        self._now_ns = 0

    @property
    def silence_ns(self) -> int:
        """The time since a state last came out of the shim [ns]; 0 without a shim."""
        last_ns = self._lanes[_UP].last_arrival_ns
        return 0 if last_ns is None else max(0, self._now_ns - last_ns)

    def take_ticks(self, schema: Schema, rows: np.ndarray) -> None:
        """Take in rows of the robot, in order."""
        rows = rows[schema.column(rows, "time_ns") >= 0]
        if not len(rows):
            return
        times_ns, forces = schema.column(rows, "time_ns"), schema.column(rows, "push_n")
        self._now_ns = int(schema.column(rows, "wall_ns")[-1])
        self._offset_ns = int(times_ns[-1]) - self._now_ns
        pushed = np.any(forces != 0.0, axis=1)
        before = np.concatenate([[self._pushed], pushed[:-1]])
        for row in np.flatnonzero(pushed & ~before):
            push = f"{force_in_words(forces[row])} at {times_ns[row] * 1e-9:.2f} s"
            self.pushes.append(push)
            self._new.append(Event("robot", f"pushed with {push}"))
        self._pushed = bool(pushed[-1])
        # Only the uplink: the edge may have nothing to send, and the robot reports old answers.
        for since_ns, _ in self._lanes[_UP].silent(self._now_ns, OUTAGE, patience_ns=_SAID_NS):
            self._open_since_ns = since_ns
            self._add(f"no message has passed the uplink since {self._time(since_ns)}")

    def take_link(self, schema: Schema, rows: np.ndarray) -> None:
        """Take in rows of the shim, in order."""
        directions = schema.column(rows, "direction")
        for direction, lane in enumerate(self._lanes):
            way = rows[directions == direction]
            sent_ns = schema.column(way, "wall_ns").astype(np.int64)
            changes = lane.add(sent_ns, schema.column(way, "achieved_ns").astype(np.int64))
            if self._offset_ns is not None:
                self._tell(direction, changes)

    def take(self) -> list[Event]:
        """Return the events since the last call."""
        return [self._new.popleft() for _ in range(len(self._new))]

    def in_words(self) -> str:
        """Return all events in a line; empty if there were none."""
        parts = []
        if self.pushes:
            parts.append(f"pushed with {', '.join(self.pushes)}")
        for name, outages_ns in zip(DIRECTIONS, self.outages_ns, strict=True):
            if outages_ns:
                longest = max(outages_ns) * 1e-9
                parts.append(f"{name} outage {len(outages_ns)} ×, at most {longest:.2f} s")
        if self._open_since_ns is not None:
            parts.append(f"no message passed the uplink after {self._time(self._open_since_ns)}")
        return "; ".join(parts)

    def _tell(self, direction: int, changes: list[Change]) -> None:
        """Add the outages that have ended. An open outage has been announced already."""
        if not changes:
            return
        said_ns = since_ns = self._open_since_ns if direction == _UP else None
        name = DIRECTIONS[direction]
        for at_ns, state in changes:
            if state == OUTAGE:
                since_ns = at_ns
            elif since_ns is not None:
                lasted_ns = at_ns - since_ns
                if lasted_ns >= TOLD_NS:
                    self.outages_ns[direction].append(lasted_ns)
                    after = f"after {lasted_ns * 1e-9:.2f} s"
                    self._add(f"the {name} passes again at {self._time(at_ns)}, {after}")
                elif since_ns == said_ns:
                    self._add(f"the {name} had no outage; the shim's rows came late")
        if direction == _UP:
            self._open_since_ns = None

    def _add(self, text: str) -> None:
        self._new.append(Event("netem", text))

    def _time(self, wall_ns: int) -> str:
        assert self._offset_ns is not None
        return f"{(wall_ns + self._offset_ns) * 1e-9:.2f} s"
