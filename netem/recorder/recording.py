"""Conversion of a recording's stamps to a profile: the delay of each period of sending time.

A period takes the delay of the message that was sent nearest to its middle. If that message is more
than a period away, the sender skipped the period. The period then still holds that delay, and is
counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from netem.profile import DIRECTIONS, DOWNLINK, LOST, UPLINK, DelayProfile
from netem.recorder.clock_offset import (
    NEVER,
    ClockOffset,
    Stamps,
    equal_least_delays,
    one_clock,
    synchronised,
)
from netem.recorder.probe import ProbeSettings
from shared.errors import LinkError


@dataclass(frozen=True)
class Recorded:
    """A recording's profile, the clocks, and counts per way.

    `held` counts periods without a message. `impossible` counts messages that by these clocks
    arrived before they were sent; their delay is set to 0.
    """

    profile: DelayProfile
    clock: ClockOffset
    held: tuple[int, int]
    impossible: tuple[int, int]


def estimate_clock(
    up: Stamps, down: Stamps, *, same_clock: bool, same_time: bool
) -> tuple[ClockOffset, str]:
    """The far clock's lead, and a warning or "".

    `same_time`: by the user's option both machines keep one time. `LinkError` if no message of a
    direction arrived.
    """
    for way, stamps in zip(DIRECTIONS, (up, down), strict=True):
        if not np.any(stamps.received_ns != NEVER):
            raise LinkError(f"expected {way} messages, got none; no profile is written")
    if same_clock:
        return one_clock(int(up.arrived.received_ns[0])), ""
    clock = equal_least_delays(up, down)
    if same_time:
        given = synchronised(up, down)
        if given is not None:
            return given, ""
        apart_ms = (abs(clock.offset_ns) - (clock.uncertainty_ns or 0)) * 1e-6
        return clock, (
            f"the machines' clocks are not synchronised but {apart_ms:.3f} ms apart or more; their "
            "offset is estimated as with --clock own"
        )
    return clock, ""


def reconstruct(
    up: Stamps,
    down: Stamps,
    clock: ClockOffset,
    *,
    settings: ProbeSettings,
    name: str,
    start_ns: int,
    end_ns: int,
    metadata: Mapping[str, Any],
) -> Recorded:
    """The profile from `start_ns` to `end_ns` of the near clock, in whole periods.

    `LinkError` if every message of a direction was lost: such a profile cannot be replayed.
    """
    period_ns = settings.period_ns
    n = max(1, (end_ns - start_ns) // period_ns)
    sent_far = fill_sending_times(down, period_ns=period_ns)
    sent = {UPLINK: up.sent_ns, DOWNLINK: clock.to_near(sent_far)}
    arrived = {UPLINK: up.received_ns != NEVER, DOWNLINK: down.received_ns != NEVER}
    received = {UPLINK: clock.to_near(up.received_ns), DOWNLINK: down.received_ns}
    delays, held, impossible = [], [], []
    for way in (UPLINK, DOWNLINK):
        took_ns = received[way] - sent[way]
        negative = arrived[way] & (took_ns < 0)
        each = np.where(arrived[way], np.maximum(took_ns, 0), LOST)
        sent_ns, each = _up_to(end_ns, sent[way], each, period_ns=period_ns)
        by_period, slept = resample(sent_ns, each, start_ns=start_ns, period_ns=period_ns, n=n)
        if np.all(by_period == LOST):
            raise LinkError(
                f"expected {DIRECTIONS[way]} messages that arrive, got only lost ones; no profile "
                "is written"
            )
        delays.append(by_period)
        held.append(slept)
        impossible.append(int(np.count_nonzero(negative)))
    described = {
        **metadata,
        "rate_hz": 1e9 / period_ns,
        "uplink_bytes": settings.uplink_bytes,
        "downlink_bytes": settings.downlink_bytes,
        "start_ns": start_ns,
        "clock": clock.method,
        "offset_ns": clock.offset_ns,
        "uncertainty_ns": clock.uncertainty_ns,
        "drift_ppm": round(clock.drift_ppm, 4),
        "held_uplink": held[UPLINK],
        "held_downlink": held[DOWNLINK],
    }
    profile = DelayProfile(name, np.array(delays), period_ns, described)
    return Recorded(profile, clock, (held[0], held[1]), (impossible[0], impossible[1]))


def fill_sending_times(stamps: Stamps, *, period_ns: int) -> np.ndarray:
    """Sending times with those of lost messages interpolated between their neighbours, (n,)."""
    known = np.flatnonzero(stamps.sent_ns != NEVER)
    first, last = known[0], known[-1]
    numbers = np.arange(len(stamps.sent_ns))
    reference_ns = int(stamps.sent_ns[first])
    between = np.interp(numbers, known, (stamps.sent_ns[known] - reference_ns).astype(float))
    outside = np.minimum(numbers - first, 0) + np.maximum(numbers - last, 0)
    filled = reference_ns + np.rint(between).astype(np.int64) + outside * period_ns
    # A time of day may be set back. The times of a sequence of messages must not decrease.
    return np.maximum.accumulate(np.where(stamps.sent_ns != NEVER, stamps.sent_ns, filled))


def resample(
    sent_ns: np.ndarray, delays_ns: np.ndarray, *, start_ns: int, period_ns: int, n: int
) -> tuple[np.ndarray, int]:
    """Delays by period (n,), from delays by message in order of sending; the number held."""
    middles = start_ns + period_ns // 2 + np.arange(n, dtype=np.int64) * period_ns
    after = np.searchsorted(sent_ns, middles).clip(1, max(1, len(sent_ns) - 1))
    after = np.minimum(after, len(sent_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(middles - sent_ns[before] <= sent_ns[after] - middles, before, after)
    slept = np.abs(middles - sent_ns[nearest]) > period_ns
    return delays_ns[nearest], int(np.count_nonzero(slept))


def _up_to(
    end_ns: int, sent_ns: np.ndarray, delays_ns: np.ndarray, *, period_ns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Append lost messages until `end_ns`, because no message sent since then is known."""
    missing = max(0, (end_ns - int(sent_ns[-1])) // period_ns)
    more = sent_ns[-1] + period_ns * np.arange(1, missing + 1)
    return np.concatenate([sent_ns, more]), np.concatenate([delays_ns, np.full(missing, LOST)])
