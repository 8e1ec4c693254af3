"""A queue that holds each message until its delay has passed: one direction of the link.

Pure: it is told the time and asked what is due. A message is due at the time it was *sent* plus the
profile's delay for that time, so that the shim's own transport does not add up. Never early, never
twice; in the order of sending unless `keep_order` is off.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from netem.profile import LOST, DelayProfile
from shared.quantities import Outage

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Due(Generic[Item]):
    """A message released from the line. `nominal_ns` is the delay it was given."""

    item: Item
    sent_ns: int
    nominal_ns: int


class DelayLine(Generic[Item]):
    """Delays items by a profile; see the module. `lost` counts those dropped on purpose."""

    def __init__(
        self,
        profile: DelayProfile,
        direction: int,
        *,
        start_ns: int,
        offset_ns: int = 0,
        loss: float = 0.0,
        keep_order: bool = True,
        outages: Sequence[Outage] = (),
        rng: np.random.Generator,
    ) -> None:
        self.profile = profile
        self.direction = direction
        self.lost = 0
        self._start_ns = start_ns
        self._offset_ns = offset_ns
        self._loss = loss
        self._keep_order = keep_order
        self._outages = outages
        self._rng = rng
        self._heap: list[tuple[int, int, Due[Item]]] = []
        self._pushed = 0
        self._last_due_ns = 0

    def __len__(self) -> int:
        return len(self._heap)

    def push(self, item: Item, *, sent_ns: int) -> int | None:
        """Take a message in; return when it is due [ns], or None if the link loses it."""
        elapsed_ns = max(0, sent_ns - self._start_ns)
        delay_ns = self.profile.delay_ns(self.direction, elapsed_ns + self._offset_ns)
        for outage in self._outages:
            if outage.begun(elapsed_ns):
                if outage.duration_ns is None:
                    delay_ns = LOST
                elif delay_ns != LOST:
                    delay_ns += outage.start_ns + outage.duration_ns - elapsed_ns
        if delay_ns == LOST or (self._loss > 0.0 and self._rng.random() < self._loss):
            self.lost += 1
            return None
        due_ns = sent_ns + delay_ns
        if self._keep_order:
            due_ns = self._last_due_ns = max(due_ns, self._last_due_ns)
        entry = Due(item, sent_ns, due_ns - sent_ns)
        heapq.heappush(self._heap, (due_ns, self._pushed, entry))
        self._pushed += 1
        return due_ns

    @property
    def next_due_ns(self) -> int | None:
        """When the next message is due [ns]; None if the line is empty."""
        return self._heap[0][0] if self._heap else None

    def pop_due(self, now_ns: int) -> list[Due[Item]]:
        """Messages due by `now_ns`, in the order they are due."""
        due = []
        while self._heap and self._heap[0][0] <= now_ns:
            due.append(heapq.heappop(self._heap)[2])
        return due

    def passes(self, now_ns: int) -> int:
        """How many whole passes through the profile have ended by `now_ns`."""
        return (max(0, now_ns - self._start_ns) + self._offset_ns) // self.profile.duration_ns
