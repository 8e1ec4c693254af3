"""Delay profiles: the one-way delay of a message sent in each period, each way.

A profile is replayed by time. A message sent t after the start takes the delay that the profile
has at t. The profile repeats when it ends. `docs/profiles.md` describes the files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from shared.config.link_settings import LinkConfig

LOST = -1
# A larger delay is taken for an error of units.
MAX_DELAY_MS = 3_600_000.0
UPLINK, DOWNLINK = 0, 1
DIRECTIONS = ("uplink", "downlink")
PERIOD_NS = 1_000_000

# Arguments: the time from the start of the profile to the sending [ns], and the size of the message
# [bytes]. Returns its delay [ns], or `LOST`.
DelaySource = Callable[[int, int], int]


class Profile(Protocol):
    """The interface of a profile: delays of messages, or a capacity that gives them."""

    @property
    def name(self) -> str:
        """The name for `--network`."""
        ...

    @property
    def period_ns(self) -> int:
        """The length of a period, for which one value holds [ns]."""
        ...

    @property
    def duration_ns(self) -> int:
        """Length of one pass [ns]."""
        ...

    @property
    def nominal_round_trip_ns(self) -> int:
        """Round trip of a message outside outages [ns]."""
        ...

    def source(self, direction: int, *, queue_bytes: int) -> DelaySource:
        """A function that gives the delay of each message of one direction."""
        ...

    def start_offset_ns(self, seed: int) -> int:
        """The place in the profile at which a run of this seed begins: whole periods [ns]."""
        ...


@dataclass(frozen=True)
class DelayProfile:
    """One-way delays [ns], one per `period_ns` of sending time, each way; `LOST` for a loss.

    `delays_ns` is (2, n) int64, uplink then downlink. `columns` has further values of each period,
    arrays (n,). Examples are the capacity (`uplink_capacity_bytes`, `downlink_capacity_bytes`) and
    the `sinr_dl_db` of a radio link. `metadata` has the source.
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
        """A function that gives the delay of each message of one direction, of any size."""
        return lambda elapsed_ns, size: self.delay_ns(direction, elapsed_ns)

    def start_offset_ns(self, seed: int) -> int:
        """The place in the profile at which a run of this seed begins: whole periods [ns]."""
        return start_offset_ns(seed, self.delays_ns.shape[1], self.period_ns)

    @property
    def nominal_round_trip_ns(self) -> int:
        """Median uplink plus median downlink delay, without losses [ns]."""
        return int(sum(np.median(way[way != LOST]) for way in self.delays_ns))


def profile_report(profile: Profile, link: LinkConfig, *, seed: int) -> dict[str, Any]:
    """Return the part of the link's report on its profile: name, length, start, worst outage."""
    begins = begin_ns(profile, link, seed=seed)
    worst = worst_outage(profile) if isinstance(profile, DelayProfile) else None
    return {
        "profile": profile.name,
        "profile_seconds": profile.duration_ns * 1e-9,
        "profile_begins_s": begins * 1e-9,
        "profile_worst_outage": worst,
    }


def worst_outage(profile: DelayProfile) -> dict[str, Any]:
    """Return direction, length [ms] and start in the profile [s] of the longest time without
    arrivals.

    A message is sent in each period, and the profile repeats. Two arrivals are at least a period
    apart, so that period does not count.
    """
    sent_ns = np.arange(2 * profile.delays_ns.shape[1]) * profile.period_ns
    worst: dict[str, Any] = {"direction": None, "ms": 0.0, "at_s": None}
    for direction, way in zip(DIRECTIONS, profile.delays_ns, strict=True):
        delays_ns = np.tile(way, 2)
        passed = delays_ns != LOST
        arrivals_ns = np.sort(sent_ns[passed] + delays_ns[passed])
        silences_ns = np.diff(arrivals_ns)
        k = int(np.argmax(silences_ns))
        silence_ms = (int(silences_ns[k]) - profile.period_ns) * 1e-6
        if silence_ms > worst["ms"]:
            at_s = (int(arrivals_ns[k]) + profile.period_ns) % profile.duration_ns * 1e-9
            worst = {"direction": direction, "ms": round(silence_ms, 3), "at_s": round(at_s, 3)}
    return worst


def begin_ns(profile: Profile, link: LinkConfig, *, seed: int) -> int:
    """Return the place in a profile at which a run begins [ns]: that of `link`, or one drawn from
    the seed.
    """
    if link.start_ns is None:
        return profile.start_offset_ns(seed)
    return link.start_ns % profile.duration_ns


def start_offset_ns(seed: int, periods: int, period_ns: int) -> int:
    """The place at which a run of this seed begins in a profile of `periods` periods [ns]."""
    return int(np.random.default_rng([seed, 7]).integers(periods)) * period_ns
