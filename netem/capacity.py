"""The capacity of the link over time, and its byte queue: `capacity:factory/001`.

A recorded delay holds for the load of the recording. While a blocker is in the beam, the link still
carries a few bytes per millisecond, and the queue fills. A controller that sends less then waits
less. So the profile gives the capacity here, and every message takes its place in a queue,

    D_k = min { t : S(t) ≥ S(max(t_k, D_k−1)) + B_k },     delay_k = D_k − t_k + base,

with S(t) the bytes that the link can have carried up to t, t_k the sending time of message k and
B_k its bytes. The queue holds a limited number of bytes. A message without room is lost
(drop-tail).

A profile may give its capacity in the columns `uplink_capacity_bytes` and
`downlink_capacity_bytes`. Otherwise the recorded delays give it. While messages wait, the link
carries a message's bytes between the departure of the message before and its own. The physical
layer's delivered bytes place them within that time if the profile has these bytes. Otherwise they
count at its end. While no message waits, the link could carry more than the load, by an unknown
amount: it counts as `_IDLE_FACTOR` times the load. Do not trust a load far above the recorded one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from netem.profile import DIRECTIONS, LOST, DelayProfile, DelaySource, start_offset_ns
from shared.errors import ProfileError

# The capacity of an idle link, as a multiple of the recorded load. It is high, so that a message's
# bytes take little of the base delay recorded for it.
_IDLE_FACTOR = 10.0
# The part of a message that arrives with its last byte at the earliest. The link holds back the
# bytes delivered before, until the missing block has come again.
_LAST = 0.01
# The minimum fraction of periods with a message. Some messages are sent a moment late.
_ENOUGH = 0.9
_DELIVERED = ("delivered_ul_bytes", "delivered_dl_bytes")
# The names of a message's size in ns-3 profiles.
_SIZES = (("uplink_bytes", "ulB"), ("downlink_bytes", "dlB"))


@dataclass(frozen=True)
class CapacityProfile:
    """Bytes that the link can carry in each period, each way.

    `capacity` is (2, n) [bytes per `period_ns`], uplink then downlink. `base_ns` (2,) is the delay
    of a message that finds the link idle. The profile repeats when it ends.
    """

    name: str
    capacity: np.ndarray
    base_ns: np.ndarray
    period_ns: int
    metadata: Mapping[str, Any]

    @property
    def duration_ns(self) -> int:
        """Length of one pass [ns]."""
        n: int = self.capacity.shape[1]
        return n * self.period_ns

    def start_offset_ns(self, seed: int) -> int:
        """The place at which a run of this seed begins [ns]; the same as in the delay profile."""
        return start_offset_ns(seed, self.capacity.shape[1], self.period_ns)

    @property
    def nominal_round_trip_ns(self) -> int:
        """The round trip of a message that finds the link idle [ns]."""
        return int(self.base_ns.sum())

    def source(self, direction: int, *, queue_bytes: int) -> DelaySource:
        """A function that gives the delay of each message of one direction. It keeps the queue."""
        return _Queue(self, direction, queue_bytes).delay_ns

    @cached_property
    def carried(self) -> np.ndarray:
        """S at the beginning of each period and at the end of the last, (2, n + 1) [bytes]."""
        return np.concatenate([np.zeros((2, 1)), np.cumsum(self.capacity, axis=1)], axis=1)


class _Queue:
    """A first-in, first-out queue of bytes. Times count from the beginning of the profile."""

    def __init__(self, profile: CapacityProfile, direction: int, queue_bytes: int) -> None:
        self._carried = profile.carried[direction]
        self._period_ns = profile.period_ns
        self._duration_ns = profile.duration_ns
        self._base_ns = int(profile.base_ns[direction])
        self._queue_bytes = queue_bytes
        self._left_ns = 0.0

    def delay_ns(self, elapsed_ns: int, size: int) -> int:
        """Delay of a message of `size` bytes sent at `elapsed_ns`; `LOST` if the queue is full."""
        begun_ns = max(float(elapsed_ns), self._left_ns)
        served = self._served(begun_ns)
        if served - self._served(float(elapsed_ns)) + size > self._queue_bytes:
            return LOST
        self._left_ns = max(begun_ns, self._when(served + size))
        return round(self._left_ns - elapsed_ns) + self._base_ns

    def _served(self, time_ns: float) -> float:
        """S(t) [bytes]."""
        passes, within_ns = divmod(time_ns, self._duration_ns)
        index, part = divmod(within_ns / self._period_ns, 1.0)
        k = min(int(index), len(self._carried) - 2)
        below, above = self._carried[k], self._carried[k + 1]
        return float(passes * self._carried[-1] + below + part * (above - below))

    def _when(self, served: float) -> float:
        """The first time at which S reaches `served` [ns]."""
        passes, within = divmod(served, float(self._carried[-1]))
        if within == 0.0 and passes > 0:  # the end of a pass, not the idle time after it
            passes, within = passes - 1, float(self._carried[-1])
        k = int(np.searchsorted(self._carried, within))
        below, above = self._carried[max(k - 1, 0)], self._carried[k]
        part = (within - below) / (above - below) if above > below else 0.0
        return passes * self._duration_ns + (max(k - 1, 0) + part) * self._period_ns


def capacity_of(profile: DelayProfile) -> CapacityProfile:
    """The capacity behind a profile (see the module). `ProfileError` if the profile has none."""
    # A recorded base delay contains the time that the message's bytes take on an idle link.
    own_ns = profile.period_ns / _IDLE_FACTOR
    base_ns = np.array([max(0, _base_ns(way) - own_ns) for way in profile.delays_ns], dtype=int)
    capacity = np.stack([_of_way(profile, way) for way in range(len(DIRECTIONS))])
    for name, carried in zip(DIRECTIONS, capacity.sum(axis=1), strict=True):
        if carried <= 0.0:
            raise ProfileError(
                f"profile {profile.name}: expected bytes that the {name} carries, got none; replay "
                "its delays, without capacity:"
            )
    return CapacityProfile(
        f"capacity:{profile.name}", capacity, base_ns, profile.period_ns, profile.metadata
    )


def _base_ns(delays_ns: np.ndarray) -> int:
    """The delay on an idle link [ns]: the 10 % quantile, because the schedule favours a few
    messages.
    """
    return int(np.quantile(delays_ns[delays_ns != LOST], 0.1, method="lower"))


def _of_way(profile: DelayProfile, way: int) -> np.ndarray:
    """The capacity of one direction (n,) [bytes per period]."""
    given = profile.columns.get(f"{DIRECTIONS[way]}_capacity_bytes")
    if given is not None:
        # A link without a load counts with its highest capacity.
        return np.where(np.isfinite(given), given, np.nanmax(given)).astype(float)
    part = _messages_in_a_period(profile, DIRECTIONS[way])
    if part < _ENOUGH:
        raise ProfileError(
            f"profile {profile.name}: expected {DIRECTIONS[way]}_capacity_bytes, or a message in "
            f"every period of {profile.period_ns * 1e-6:g} ms, got {part:.3g}: the capacity "
            "in between was not measured; replay its delays, without capacity:"
        )
    size = next((profile.metadata[key] for key in _SIZES[way] if key in profile.metadata), None)
    if not isinstance(size, int | float) or not size > 0:
        raise ProfileError(
            f"profile {profile.name}: expected {DIRECTIONS[way]}_capacity_bytes, or how many bytes "
            f"the recorded messages had ({_SIZES[way][0]} in its metadata), got neither"
        )
    delivered = profile.columns.get(_DELIVERED[way])
    return _behind(profile.delays_ns[way], float(size), delivered, profile.period_ns)


def _messages_in_a_period(profile: DelayProfile, direction: str) -> float:
    """The recorded load [messages per period], by the metadata; 1 if it is not in them."""
    of = {key: profile.metadata.get(key) for key in ("packets", "interpolated", "rate_hz")}
    packets, interpolated = (
        each.get(direction) if isinstance(each, dict) else None
        for each in (of["packets"], of["interpolated"])
    )
    known = [1.0]
    if isinstance(packets, int | float):
        known.append(packets / profile.delays_ns.shape[1])
    elif isinstance(of["rate_hz"], int | float):
        known.append(of["rate_hz"] * profile.period_ns * 1e-9)
    if isinstance(interpolated, int | float):
        known.append(1.0 - interpolated)
    return float(min(known))


def _behind(
    delays_ns: np.ndarray, size: float, delivered: np.ndarray | None, period_ns: int
) -> np.ndarray:
    """The capacity (n,) [bytes per period] behind the delays of messages of `size` bytes."""
    n = len(delays_ns)
    sent = np.arange(n, dtype=float)
    passed = np.flatnonzero(delays_ns != LOST)
    waited = np.maximum(0, delays_ns[passed] - _base_ns(delays_ns)) / period_ns
    left = np.maximum.accumulate(sent[passed] + waited)
    weights = np.ones(n) if delivered is None else delivered.astype(float)
    capacity, busy = np.zeros(n), np.zeros(n)
    before = -1.0
    for k, end in zip(passed, left, strict=True):
        begin = max(float(k), before)
        before = end
        periods = np.arange(int(begin), min(int(np.ceil(end)), n))
        if len(periods) == 0:
            continue
        overlap = np.minimum(periods + 1, end) - np.maximum(periods, begin)
        busy[periods] += overlap
        if end > n:  # it leaves after the profile's end: the part carried before is unknown
            continue
        share = overlap * weights[periods]
        early = 0.0 if delivered is None or share.sum() <= 0.0 else 1.0 - _LAST
        capacity[periods] += early * size * share / max(share.sum(), 1e-9)
        capacity[periods[-1]] += (1.0 - early) * size
    return capacity + np.maximum(0.0, 1.0 - busy) * _IDLE_FACTOR * size
