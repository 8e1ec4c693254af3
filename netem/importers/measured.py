"""A measurement of a link before it is a profile: the packets, their sending times and delays.

The two ends of a link have two clocks. With θ = clock of the edge − clock of the robot, one-way
delays read as up + θ and down − θ. Their sum is right, but one of them may be negative.
`with_one_clock` takes θ from the assumption that the shortest delays of both ways are equal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from netem.profile import DIRECTIONS, UPLINK
from shared.errors import ProfileError

UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "µs": 1_000, "μs": 1_000, "ns": 1}


@dataclass(frozen=True)
class Way:
    """Packets of one direction in the order of sending, (n,) each. A lost packet's `delay_ns` is
    unused.

    `message_bytes` and `rate_hz` describe the traffic of the measurement, None where unknown.
    `unknown_ns` has the sending times of packets of which it is unknown whether they arrived.
    `counts` is the numbers of packets sent and lost, if an entry here does not stand for one
    packet.
    """

    sent_ns: np.ndarray
    delay_ns: np.ndarray
    lost: np.ndarray
    message_bytes: int | None = None
    rate_hz: float | None = None
    unknown_ns: np.ndarray | None = None
    counts: tuple[int, int | None] | None = None

    @property
    def counted(self) -> tuple[int, int | None]:
        """The numbers of packets sent and of packets lost. The second is None if unknown."""
        return self.counts or (len(self.sent_ns), int(self.lost.sum()))


@dataclass(frozen=True)
class Series:
    """A further quantity over the time of the packets. A period takes its sum, or its mean."""

    time_ns: np.ndarray
    values: np.ndarray
    mean: bool = False


@dataclass(frozen=True)
class Measured:
    """The measurement in one file or a pair. `ways` is uplink and downlink, None if not measured.

    `notes` are the assumptions made, in sentences for the user. `two_clocks` tells whether a
    one-way delay is a difference between the clocks of the two ends, which may be negative.
    """

    ways: tuple[Way | None, Way | None]
    notes: tuple[str, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    series: Mapping[str, Series] = field(default_factory=dict)
    two_clocks: bool = False


def one_way(direction: int, way: Way, *notes: str, **series: Series) -> Measured:
    """A measurement of one direction only."""
    return Measured((way, None) if direction == UPLINK else (None, way), notes, series=series)


def ordered(
    sent_ns: Any,
    delay_ns: Any,
    lost: Any = None,
    *,
    message_bytes: int | None = None,
    rate_hz: float | None = None,
) -> Way:
    """A `Way` of packets in any order."""
    sent, delay = np.asarray(sent_ns, dtype=np.int64), np.asarray(delay_ns, dtype=np.int64)
    missing = np.zeros(len(sent), dtype=bool) if lost is None else np.asarray(lost, dtype=bool)
    order = np.argsort(sent, kind="stable")
    return Way(sent[order], delay[order], missing[order], message_bytes, rate_hz)


def without_unfinished(way: Way, end_ns: int) -> tuple[Way, int]:
    """Leave out the packets that may still be under way at `end_ns`. Return their number too.

    A packet that never arrived is lost only if the record goes on for longer than the longest
    delay in it.
    """
    longest = int(way.delay_ns[~way.lost].max()) if not way.lost.all() else 0
    known = ~way.lost | (way.sent_ns + longest <= end_ns)
    kept = replace(
        way, sent_ns=way.sent_ns[known], delay_ns=way.delay_ns[known], lost=way.lost[known]
    )
    return kept, int((~known).sum())


def stepped_back_note(times_ns: np.ndarray) -> tuple[str, ...]:
    """A note for the user on times that step back in the order of the file; empty if none do."""
    steps = np.diff(times_ns)
    back = steps[steps < 0]
    if not len(back):
        return ()
    if len(back) == len(steps):
        return ("the last packets come first: put in order",)
    return (
        f"times step back {len(back)} times, by {-int(back.min()) * 1e-9:.6g} s at most: packets "
        "taken in the order of their times; was a clock set?",
    )


def unfinished_note(count: int) -> tuple[str, ...]:
    """A note for the user on the packets that `without_unfinished` left out."""
    if not count:
        return ()
    return (f"{count} packets left out that may still have been under way when the record ended",)


def with_one_clock(measured: Measured, *, clock: str | None, name: str) -> Measured:
    """The measurement by the robot's clock. `ProfileError` if the clocks plainly disagree."""
    if not measured.two_clocks and clock != "offset":
        return measured
    up, down = measured.ways
    least = [None if way is None or way.lost.all() else _shortest(way) for way in (up, down)]
    if clock == "half":
        raise ProfileError(
            f"{name}: --clock half: expected round trips, got one-way delays; try --clock offset"
        )
    if clock == "offset":
        if up is None or down is None or None in least or not measured.two_clocks:
            raise ProfileError(
                f"{name}: --clock offset: expected one-way delays of both ways, got less; give the "
                "other way's measurement too"
            )
        offset = (_shortest(up) - _shortest(down)) // 2
        ways = (
            replace(up, delay_ns=up.delay_ns - offset),
            replace(down, delay_ns=down.delay_ns + offset, sent_ns=down.sent_ns - offset),
        )
        note = (
            f"clocks: the edge's taken to be {offset * 1e-6:+.3f} ms ahead, so that the shortest "
            "delays of both ways are equal"
        )
        return replace(measured, ways=ways, notes=(*measured.notes, note))
    text = []
    for direction, shortest in zip(DIRECTIONS, least, strict=True):
        if shortest is None:
            continue
        text.append(f"{direction} {shortest * 1e-6:.3f} ms")
        if shortest < 0:
            raise ProfileError(
                f"{name}: expected {direction} delays of 0 or more, got negative ones, down to "
                f"{shortest * 1e-6:.3f} ms, because the clocks of the two ends differ; try --clock "
                "offset (both ways measured: equal shortest delays) or --clock half (round trips)"
            )
    note = f"one-way delays as the clocks of the two ends tell them, shortest {', '.join(text)}"
    return replace(measured, notes=(*measured.notes, note))


def _shortest(way: Way) -> int:
    return int(way.delay_ns[~way.lost].min())


def halved(sent_ns: Any, round_trip_ns: Any, lost: Any, **traffic: Any) -> tuple[Way, Way]:
    """Both ways of round trips, half the time each. A lost round trip is lost on both ways.

    Both halves stand at the time of sending. The sending time of the reply is unknown.
    """
    trip = np.asarray(round_trip_ns, dtype=np.int64)
    return (
        ordered(sent_ns, trip // 2, lost, **traffic),
        ordered(sent_ns, trip - trip // 2, lost, **traffic),
    )
