"""Pauses of a measurement: spans without a packet, which tell nothing about the link.

A pause lasts at least `PAUSE_NS`, and at least `_MANY` times the usual time between packets.
Interpolation would give a ramp of delays that no packet had. By the user's choice the importer
refuses a pause, cuts it out of both directions, or counts it as lost. In a record of arrivals
alone, a pause is an outage. In a measurement that stopped and went on, it is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from netem.importers.measured import Measured, Way
from netem.profile import DIRECTIONS
from shared.errors import ProfileError

PAUSE_NS = 1_000_000_000
TREATMENTS = ("refuse", "cut", "lost")
_MANY = 10
_TOLD = 3
_NONE = np.empty((0, 2), np.int64)


def usual_spacing_ns(way: Way, period_ns: int) -> int:
    """The median time between the periods with a packet [ns]; 0 if there is one such period."""
    steps = np.diff(np.unique(_sent(way) // period_ns))
    return int(np.median(steps)) * period_ns if len(steps) else 0


def without_pauses(measured: Measured, *, name: str, period_ns: int, treatment: str) -> Measured:
    """The measurement, its pauses cut out or lost. `ProfileError` if `treatment` is neither."""
    found = [_NONE if way is None else _pauses(way, period_ns) for way in measured.ways]
    same = np.array_equal(found[0], found[1])
    told = [
        f"{(end - begin) * 1e-9:.6g} s without {'' if same else direction + ' '}packets, "
        f"{(begin - int(way.sent_ns[0])) * 1e-9:.6g} s after the first"
        for direction, way, pauses in zip(DIRECTIONS, measured.ways, found, strict=True)
        if way is not None and not (same and direction == DIRECTIONS[1])
        for begin, end in pauses.tolist()
    ]
    if not told:
        return measured
    more = f" and {len(told) - _TOLD} more" if len(told) > _TOLD else ""
    places = "; ".join(told[:_TOLD]) + more
    if treatment == "refuse":
        raise ProfileError(
            f"{name}: expected packets throughout, got {places} (a pause, an outage, or a clock "
            "that was set); try --pause cut, which leaves it out, or --pause lost"
        )
    if treatment == "lost":
        ways = [
            way and _with_losses(way, begin_ns)
            for way, (begin_ns, _) in zip(measured.ways, (p.T for p in found), strict=True)
        ]
        note = f"taken as lost: {places}"
        return replace(measured, ways=(ways[0], ways[1]), notes=(*measured.notes, note))
    return _cut(measured, _merged(np.concatenate(found)), period_ns, f"cut out: {places}")


def _sent(way: Way) -> np.ndarray:
    """The sending times of this way's packets, and of round trips that did not reach this way."""
    return way.sent_ns if way.unknown_ns is None else np.union1d(way.sent_ns, way.unknown_ns)


def _pauses(way: Way, period_ns: int) -> np.ndarray:
    """Start and end of each pause [ns], (n, 2). The packet before a pause keeps its usual time."""
    sent, usual_ns = _sent(way), usual_spacing_ns(way, period_ns)
    long = np.diff(sent) >= max(PAUSE_NS, _MANY * usual_ns)
    return np.stack([sent[:-1][long] + usual_ns, sent[1:][long]], axis=1) if usual_ns else _NONE


def _with_losses(way: Way, begin_ns: np.ndarray) -> Way:
    """Add a lost packet at the beginning of each pause. The counts leave these packets out."""
    order = np.argsort(np.concatenate([way.sent_ns, begin_ns]), kind="stable")
    nothing = np.zeros_like(begin_ns)
    return replace(
        way,
        sent_ns=np.concatenate([way.sent_ns, begin_ns])[order],
        delay_ns=np.concatenate([way.delay_ns, nothing])[order],
        lost=np.concatenate([way.lost, nothing == 0])[order],
        counts=way.counted,
    )


def _merged(pauses: np.ndarray) -> np.ndarray:
    """The pauses in order, with overlapping ones joined."""
    joined: list[list[int]] = []
    for begin, end in sorted(pauses.tolist()):
        if joined and begin <= joined[-1][1]:
            joined[-1][1] = max(joined[-1][1], end)
        else:
            joined.append([begin, end])
    return np.array(joined, np.int64)


def _cut(measured: Measured, pauses: np.ndarray, period_ns: int, note: str) -> Measured:
    """Cut the pauses out by whole periods. Later packets keep their place in their period."""
    begins, ends = pauses.T
    passed = np.append(0, np.cumsum((ends - begins) // period_ns * period_ns))

    def kept(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A mask of the times outside pauses, and all times less the pauses before them [ns]."""
        before = np.searchsorted(ends, times, side="right")
        inside = np.append(begins, np.iinfo(np.int64).max)[before] < times
        return ~inside, times - passed[before]

    ways: list[Way | None] = []
    for way in measured.ways:
        if way is None:
            ways.append(None)
            continue
        keep, sent = kept(way.sent_ns)
        unknown = way.unknown_ns
        if unknown is not None:
            known, moved = kept(unknown)
            unknown = moved[known]
        ways.append(
            replace(
                way,
                sent_ns=sent[keep],
                delay_ns=way.delay_ns[keep],
                lost=way.lost[keep],
                unknown_ns=unknown,
                counts=way.counted,
            )
        )
    series = {}
    for key, each in measured.series.items():
        keep, times = kept(each.time_ns)
        series[key] = replace(each, time_ns=times[keep], values=each.values[keep])
    notes = (*measured.notes, note)
    return replace(measured, ways=(ways[0], ways[1]), series=series, notes=notes)
