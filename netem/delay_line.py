"""One direction of the link: a queue that holds each message until its delay has passed.

The queue reads no clock. Its caller gives the time and takes the messages that are due. A message
is due at the time at which it was *sent* plus the profile's delay, so the shim's own transport does
not add to the delay. No message leaves early or twice. Messages leave in the order of sending
unless `keep_order` is off.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from netem.profile import DIRECTIONS, LOST, Profile, begin_ns
from shared.config.link_settings import LinkConfig
from shared.config.quantities import Outage
from shared.wire.operator.commands import AddDelay, Cut, LinkCommand, Restore, SetLoss, Stall

# Outages that overlap; of more, the last ones count.
_MAX_OUTAGES = 100

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Due(Generic[Item]):
    """A message released from the line, with the delay that the line gave it, `nominal_ns`."""

    item: Item
    sent_ns: int
    nominal_ns: int


def make_lines(
    profile: Profile, config: LinkConfig, *, seed: int, start_ns: int
) -> list[DelayLine[Any]]:
    """Both directions of a link that begins at `start_ns`, uplink first."""
    count_as = (config.uplink_bytes, config.downlink_bytes)
    return [
        DelayLine(
            profile,
            direction,
            start_ns=start_ns,
            offset_ns=begin_ns(profile, config, seed=seed),
            loss=config.loss,
            keep_order=config.keep_order,
            outages=config.outages,
            count_as=count_as[direction],
            queue_bytes=config.queue_bytes,
            rng=np.random.default_rng([seed, 2, direction]),
        )
        for direction in range(len(DIRECTIONS))
    ]


def apply_to(
    lines: Sequence[DelayLine[Any]],
    command: LinkCommand,
    *,
    now_ns: int,
    profile: Profile | None,
    config: LinkConfig,
    seed: int,
) -> None:
    """Carry out an operator's command on both directions, for messages sent from `now_ns` on.

    `profile` is that of a `ReplaceProfile`; it begins where a run of this seed begins in it.
    """
    place_ns = 0 if profile is None else begin_ns(profile, config, seed=seed)
    for line in lines:
        line.change(command, now_ns=now_ns, profile=profile, place_ns=place_ns)


class DelayLine(Generic[Item]):
    """One direction that delays items by a profile. `lost` counts the items that it loses."""

    def __init__(
        self,
        profile: Profile,
        direction: int,
        *,
        start_ns: int,
        offset_ns: int = 0,
        loss: float = 0.0,
        keep_order: bool = True,
        outages: Sequence[Outage] = (),
        count_as: int = 0,
        queue_bytes: int = LinkConfig.queue_bytes,
        rng: np.random.Generator,
    ) -> None:
        self.profile = profile
        self.lost = 0
        self._direction = direction
        self._queue_bytes = queue_bytes
        self._delay_ns = profile.source(direction, queue_bytes=queue_bytes)
        self._added_ns = 0
        self._settings_loss = loss
        self._count_as = count_as
        self._start_ns = start_ns
        self._offset_ns = offset_ns
        self._loss = loss
        self._keep_order = keep_order
        self._outages = tuple(outages)
        self._rng = rng
        self._heap: list[tuple[int, int, Due[Item]]] = []
        self._pushed = 0
        self._last_due_ns = 0

    def __len__(self) -> int:
        return len(self._heap)

    def push(self, item: Item, *, sent_ns: int, size: int = 0) -> int | None:
        """Queue a message of `size` bytes. Return its due time [ns], None if the link loses it."""
        elapsed_ns = max(0, sent_ns - self._start_ns)
        delay_ns = self._delay_ns(elapsed_ns + self._offset_ns, self._count_as or size)
        for outage in self._outages:
            if outage.begun(elapsed_ns):
                if outage.duration_ns is None:
                    delay_ns = LOST
                elif delay_ns != LOST:
                    delay_ns += outage.start_ns + outage.duration_ns - elapsed_ns
        if delay_ns == LOST or (self._loss > 0.0 and self._rng.random() < self._loss):
            self.lost += 1
            return None
        due_ns = sent_ns + delay_ns + self._added_ns
        if self._keep_order:
            due_ns = self._last_due_ns = max(due_ns, self._last_due_ns)
        entry = Due(item, sent_ns, due_ns - sent_ns)
        heapq.heappush(self._heap, (due_ns, self._pushed, entry))
        self._pushed += 1
        return due_ns

    def change(
        self, command: LinkCommand, *, now_ns: int, profile: Profile | None, place_ns: int
    ) -> None:
        """Carry out an operator's command on this direction, as `apply_to`.

        `place_ns` is the place in a new `profile` at which the link goes on [ns].
        """
        elapsed_ns = max(0, now_ns - self._start_ns)
        if isinstance(command, Restore):
            self._outages = tuple(each for each in self._outages if each.start_ns > elapsed_ns)
            self._added_ns, self._loss = 0, self._settings_loss
        elif isinstance(command, Cut | Stall):
            duration_ns = command.duration_ns if isinstance(command, Stall) else None
            lasting = [each for each in self._outages if not each.over(elapsed_ns)]
            self._outages = (*lasting[-_MAX_OUTAGES:], Outage(elapsed_ns, duration_ns))
        elif isinstance(command, AddDelay):
            half_ns = command.round_trip_ns // 2
            self._added_ns = half_ns if self._direction else command.round_trip_ns - half_ns
        elif isinstance(command, SetLoss):
            self._loss = command.probability
        else:
            assert profile is not None
            self.profile = profile
            self._delay_ns = profile.source(self._direction, queue_bytes=self._queue_bytes)
            self._offset_ns = place_ns - elapsed_ns

    @property
    def next_due_ns(self) -> int | None:
        """The time at which the next message is due [ns]; None if the line is empty."""
        return self._heap[0][0] if self._heap else None

    def pop_due(self, now_ns: int, *, limit: int | None = None) -> list[Due[Item]]:
        """Remove and return the messages due by `now_ns`, in order, at most `limit`."""
        due: list[Due[Item]] = []
        while self._heap and self._heap[0][0] <= now_ns and len(due) != limit:
            due.append(heapq.heappop(self._heap)[2])
        return due

    def passes(self, now_ns: int) -> int:
        """The number of whole passes through the profile that have ended by `now_ns`."""
        return (max(0, now_ns - self._start_ns) + self._offset_ns) // self.profile.duration_ns
