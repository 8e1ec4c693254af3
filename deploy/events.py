"""What happens in a run, from its telemetry: pushes, and times in which nothing passes the link.

Blocks arrive on the bus's threads, `take` is called by whoever tells a person. What the robot does
about it, such as holding its joints, the robot says itself.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from shared.telemetry import Schema

# Nothing released for so long is an outage; said while it lasts if it lasts longer: what the shim
# reports comes in blocks, and late on a busy machine.
OUTAGE_NS = 150_000_000
_SAID_NS = 500_000_000
_UP = 0
_AXES = "xyz"


@dataclass(frozen=True)
class Event:
    """Something that happened, and the service it happened to."""

    name: str
    text: str


class Events:
    """Events of a run, and how many there were."""

    def __init__(self) -> None:
        self.pushes: list[str] = []
        self.outages_ns: list[int] = []
        self._new: deque[Event] = deque()
        self._pushed = False
        self._open_since_ns: int | None = None
        self._released_ns: int | None = None
        # Task time minus the machine's clock; None before the task begins.
        self._offset_ns: int | None = None
        self._now_ns = 0

    @property
    def silence_ns(self) -> int:
        """How long ago a state last came out of the shim; 0 without a shim."""
        return 0 if self._released_ns is None else max(0, self._now_ns - self._released_ns)

    def take_ticks(self, schema: Schema, rows: np.ndarray) -> None:
        """Rows of the robot, in order."""
        rows = rows[schema.column(rows, "time_ns") >= 0]
        if not len(rows):
            return
        times_ns, forces = schema.column(rows, "time_ns"), schema.column(rows, "push_n")
        self._now_ns = int(schema.column(rows, "wall_ns")[-1])
        self._offset_ns = int(times_ns[-1]) - self._now_ns
        pushed = np.any(forces != 0.0, axis=1)
        before = np.concatenate([[self._pushed], pushed[:-1]])
        for row in np.flatnonzero(pushed & ~before):
            push = f"{_force_in_words(forces[row])} at {times_ns[row] * 1e-9:.2f} s"
            self.pushes.append(push)
            self._new.append(Event("robot", f"pushed with {push}"))
        self._pushed = bool(pushed[-1])
        if self._open_since_ns is None and self.silence_ns >= _SAID_NS:
            self._open_since_ns = self._now_ns - self.silence_ns
            self._add(f"nothing passes the link since {self._time(self._open_since_ns)}")

    def take_link(self, schema: Schema, rows: np.ndarray) -> None:
        """Rows of the shim, in order. The robot sends all the time; answers may be rare."""
        achieved_ns = schema.column(rows, "achieved_ns")
        passed = (schema.column(rows, "direction") == _UP) & (achieved_ns >= 0)
        released_ns = (schema.column(rows, "wall_ns") + achieved_ns)[passed]
        if not len(released_ns):
            return
        before = released_ns[0] if self._released_ns is None else self._released_ns
        gaps_ns = np.diff(released_ns, prepend=before)
        self._released_ns = int(released_ns[-1])
        if self._offset_ns is None:
            return
        for row in np.flatnonzero(gaps_ns >= OUTAGE_NS):
            self.outages_ns.append(int(gaps_ns[row]))
            at = self._time(int(released_ns[row]))
            self._add(f"the link passes again at {at}, after {gaps_ns[row] * 1e-9:.2f} s")
        if self._open_since_ns is not None and not np.any(gaps_ns >= OUTAGE_NS):
            self._add("the link passes; its report was late")
        self._open_since_ns = None

    def take(self) -> list[Event]:
        """Events since the last call."""
        return [self._new.popleft() for _ in range(len(self._new))]

    def in_words(self) -> str:
        """What happened, in a line; empty if nothing did."""
        parts = []
        if self.pushes:
            parts.append(f"pushed with {', '.join(self.pushes)}")
        if self.outages_ns:
            longest = max(self.outages_ns) * 1e-9
            parts.append(f"link stood still {len(self.outages_ns)} ×, at most {longest:.2f} s")
        if self._open_since_ns is not None:
            parts.append(f"nothing passed since {self._time(self._open_since_ns)}")
        return "; ".join(parts)

    def _add(self, text: str) -> None:
        self._new.append(Event("netem", text))

    def _time(self, wall_ns: int) -> str:
        assert self._offset_ns is not None
        return f"{(wall_ns + self._offset_ns) * 1e-9:.2f} s"


def _force_in_words(force: np.ndarray) -> str:
    """A force [N] in the world: along an axis, or by its components."""
    axis = int(np.argmax(np.abs(force)))
    if np.count_nonzero(force) > 1:
        return f"({', '.join(f'{part:.0f}' for part in force)}) N"
    return f"{abs(force[axis]):.0f} N to {'-' if force[axis] < 0 else '+'}{_AXES[axis]}"
