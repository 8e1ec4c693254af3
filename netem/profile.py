"""Delay profiles: the one-way delay, each way, of a message sent at each instant.

A profile is replayed by time: a message sent t after the start takes the delay that the profile
holds for t, and the profile repeats when it ends. `docs/profiles.md` describes the files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from shared.config.settings import LinkConfig

LOST = -1
# No link of use is slower; a larger number is an error of units.
MAX_DELAY_MS = 3_600_000.0
UPLINK, DOWNLINK = 0, 1
DIRECTIONS = ("uplink", "downlink")
PERIOD_NS = 1_000_000

# Delay [ns] of a message of so many bytes sent so long [ns] after the profile began, or `LOST`.
DelaySource = Callable[[int, int], int]


class Profile(Protocol):
    """What a link replays: the delays of messages, or the capacity that makes them."""

    @property
    def name(self) -> str:
        """What `--network` names it by."""
        ...

    @property
    def period_ns(self) -> int:
        """How long one value holds [ns]."""
        ...

    @property
    def duration_ns(self) -> int:
        """Length of one pass [ns]."""
        ...

    @property
    def nominal_round_trip_ns(self) -> int:
        """Round trip of a message that meets nothing unusual [ns]."""
        ...

    def source(self, direction: int, *, queue_bytes: int) -> DelaySource:
        """The delay of each message of one direction."""
        ...

    def start_offset_ns(self, seed: int) -> int:
        """Where in the profile a run of this seed begins: a whole number of periods [ns]."""
        ...


@dataclass(frozen=True)
class DelayProfile:
    """One-way delays [ns], one per `period_ns` of sending time, each way; `LOST` for a loss.

    `delays_ns` (2, n) int64, uplink then downlink. `columns` is what else is known of each period,
    arrays (n,): `uplink_capacity_bytes` and `downlink_capacity_bytes`, what the link could have
    carried in it, or a radio link's `sinr_dl_db`. `metadata` says where it comes from.
    """

    name: str
    delays_ns: np.ndarray
    period_ns: int = PERIOD_NS
    metadata: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def duration_ns(self) -> int:
        """Length of one pass [ns]."""
        n: int = self.delays_ns.shape[1]
        return n * self.period_ns

    def delay_ns(self, direction: int, elapsed_ns: int) -> int:
        """Delay of a message sent `elapsed_ns` after the profile began, or `LOST`."""
        index = (elapsed_ns // self.period_ns) % self.delays_ns.shape[1]
        return int(self.delays_ns[direction, index])

    def source(self, direction: int, *, queue_bytes: int) -> DelaySource:
        """The delay of each message of one direction, however large it is."""
        return lambda elapsed_ns, size: self.delay_ns(direction, elapsed_ns)

    def start_offset_ns(self, seed: int) -> int:
        """Where in the profile a run of this seed begins: a whole number of periods."""
        return start_offset_ns(seed, self.delays_ns.shape[1], self.period_ns)

    @property
    def nominal_round_trip_ns(self) -> int:
        """Median uplink plus median downlink delay [ns], losses aside."""
        return int(sum(np.median(way[way != LOST]) for way in self.delays_ns))


def begin_ns(profile: Profile, link: LinkConfig, *, seed: int) -> int:
    """Return where in a profile a run begins [ns]: where `link` says, or where the seed draws."""
    if link.start_ns is None:
        return profile.start_offset_ns(seed)
    return link.start_ns % profile.duration_ns


def start_offset_ns(seed: int, periods: int, period_ns: int) -> int:
    """Where a run of this seed begins in a profile of so many periods [ns]."""
    return int(np.random.default_rng([seed, 7]).integers(periods)) * period_ns
