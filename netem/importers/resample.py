"""Resampling: packets at any sending times become a profile of equal periods.

A period takes the longest delay of the packets sent in it. Of a datagram in fragments, the last
fragment counts. A period is lost only if all its packets are lost.

A period without a packet is filled. Between two successive packets that arrived, it is interpolated
along the time of sending. This is exact after an outage in which packets queue: they leave
together, and a packet sent 1 ms later waits 1 ms less. A lost packet stands for the time until the
next packet. So does a packet that arrived before a lost one. The share of periods lost is then the
share of packets lost. The length of an outage is exact to within the time between packets.

The boundaries of the periods lie at a phase at which no packets are sent. So they split no burst,
and rounded times do no harm. Both directions share one axis, the time for which both were measured.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from netem.importers.measured import Measured, Series, Way
from netem.importers.options import Options
from netem.importers.pauses import usual_spacing_ns, without_pauses
from netem.profile import DIRECTIONS, LOST, MAX_DELAY_MS, DelayProfile
from shared.errors import ProfileError

MAX_PERIODS = 10_000_000
# The least time without packets that is worth a note: a multiple of the usual one, and [ns].
_GAP, _LEAST_GAP_NS = 5, 50_000_000
# The least number of packets in each period that is worth a note.
_DENSE = 10
# A note is due if this quantile of the delays differs by more than this share.
_HIGH, _OTHER = 0.99, 0.05


def to_profile(
    measured: Measured, options: Options, *, name: str, constant_ns: int | None = None
) -> DelayProfile:
    """The profile of a measurement. `constant_ns` is the delay of a direction that was not
    measured.
    """
    period_ns = options.period_ns
    measured = without_pauses(measured, name=name, period_ns=period_ns, treatment=options.pause)
    notes = list(measured.notes)
    for direction, way in zip(DIRECTIONS, measured.ways, strict=True):
        if way is not None:
            _check(name, direction, way)
    ways = _on_one_axis(name, measured, notes)
    spans = [(int(way.sent_ns[0]), _end(way, period_ns)) for way in ways if way is not None]
    spans += [(int(s.time_ns.min()), int(s.time_ns.max())) for s in measured.series.values()]
    begin, end = max(first for first, _ in spans), min(last for _, last in spans)
    if begin > end:
        raise ProfileError(
            f"{name}: expected files of one time, got some that do not overlap; give files of one "
            "measurement"
        )
    packets = np.concatenate([way.sent_ns for way in ways if way is not None])
    check_span(name, end - begin, period_ns)
    start = _start(packets, begin, period_ns)
    n = (end - start) // period_ns + 1
    if end - begin < 0.99 * max(last - first for first, last in spans):
        notes.append(f"kept the {(end - begin) * 1e-9:.3f} s that all files cover")
    lone = options.lone_loss == "period"
    delays, filled, surprises = [], {}, defaultdict(list)
    for direction, way in zip(DIRECTIONS, ways, strict=True):
        if way is None:
            delays.append(np.full(n, LOST if constant_ns is None else constant_ns))
            continue
        way_ns, empty = _resampled(way, start, n, period_ns, lone_losses=lone)
        if (way_ns == LOST).all():
            raise ProfileError(
                f"{name}: expected {direction} packets that arrived, got {n} periods in which all "
                "are lost; measure again"
            )
        delays.append(way_ns)
        filled[direction] = float((empty & (way_ns != LOST)).mean())
        surprising = (
            *_loss_notes(way, way_ns == LOST, empty, lone_losses=lone),
            *_gap_note(way, period_ns),
            *_dense_note(way, period_ns),
            *_quantile_note(way, way_ns),
        )
        for note in surprising:
            surprises[note].append(direction)
    notes += [f"{' and '.join(of)}: {note}" for note, of in surprises.items()]
    return DelayProfile(
        name=name,
        delays_ns=np.vstack(delays).astype(np.int64),
        period_ns=period_ns,
        metadata={
            **_metadata(measured, ways, n, period_ns, notes),
            "interpolated": {direction: round(part, 6) for direction, part in filled.items()},
        },
        columns={k: _binned(s, start, n, period_ns) for k, s in measured.series.items()},
    )


def check_span(name: object, span_ns: int, period_ns: int) -> None:
    """Raise `ProfileError` if the span has `MAX_PERIODS` periods or more."""
    if span_ns >= MAX_PERIODS * period_ns:
        raise ProfileError(
            f"{name}: expected at most {MAX_PERIODS} periods, got {span_ns * 1e-9:.6g} s in "
            f"periods of {period_ns * 1e-6:g} ms; check the units, or try a longer --period"
        )


def _check(name: str, direction: str, way: Way) -> None:
    passed = way.delay_ns[~way.lost]
    if not len(passed):
        raise ProfileError(
            f"{name}: expected {direction} packets that arrived, got none; measure again"
        )
    if passed.min() < 0 or passed.max() > MAX_DELAY_MS * 1e6:
        worst = passed.min() if passed.min() < 0 else passed.max()
        raise ProfileError(
            f"{name}: expected {direction} delays from 0 to {MAX_DELAY_MS / 1000:g} s, got "
            f"{worst * 1e-9:.6g} s; check the units"
        )


def _on_one_axis(name: str, measured: Measured, notes: list[str]) -> list[Way | None]:
    """Both directions unchanged, or both from 0 if their measurements do not overlap in time."""
    up, down = measured.ways
    if up is None or down is None:
        return [up, down]
    apart = up.sent_ns[0] > down.sent_ns[-1] or down.sent_ns[0] > up.sent_ns[-1]
    if not apart:
        return [up, down]
    if measured.series:
        raise ProfileError(
            f"{name}: expected both ways of one time, got some that do not overlap; give files of "
            "one measurement"
        )
    notes.append("the two ways were measured at different times; both are taken from their start")
    return [replace(way, sent_ns=way.sent_ns - way.sent_ns[0]) for way in (up, down)]


def _start(sent_ns: np.ndarray, begin_ns: int, period_ns: int) -> int:
    """The beginning of the first period [ns], at `begin_ns` or up to a period before.

    The gaps are those between the sending times modulo the period. The beginning is the middle of
    the gap before `begin_ns` if that gap is at least half as wide as the widest. Otherwise it is
    the middle of the widest gap.
    """
    phases = np.unique((sent_ns - begin_ns) % period_ns)
    gaps = np.diff(phases, append=phases[0] + period_ns)
    widest = int(np.argmax(gaps))
    if gaps[-1] >= gaps[widest] / 2:
        widest = -1
    boundary = int(phases[widest] + gaps[widest] // 2)
    return begin_ns - (-boundary) % period_ns


def _end(way: Way, period_ns: int) -> int:
    """The end of the measurement of a direction [ns]. A lost last packet stands for as long as
    other packets.
    """
    last = int(way.sent_ns[-1])
    return last + max(usual_spacing_ns(way, period_ns) - period_ns, 0) * bool(way.lost[-1])


def _resampled(
    way: Way, start_ns: int, n: int, period_ns: int, *, lone_losses: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The delay of each of `n` periods [ns] or `LOST`, and a mask of the periods without a packet.

    With `lone_losses`, a packet lost between two that arrived is lost in its own period only.
    """
    index = (way.sent_ns - start_ns) // period_ns
    delay = np.where(way.lost, LOST, way.delay_ns)
    order = np.lexsort((delay, index))
    index, delay, sent = index[order], delay[order], way.sent_ns[order]
    longest = np.append(np.diff(index) > 0, True)
    index, delay, sent = index[longest], delay[longest], sent[longest]
    before = np.maximum(np.searchsorted(index, np.arange(n), side="right") - 1, 0)
    after = np.minimum(before + 1, len(index) - 1)
    empty = index[before] != np.arange(n)
    if lone_losses:
        around = np.concatenate([[True], delay == LOST, [True]])
        lone = (delay == LOST) & ~around[:-2] & ~around[2:]
        before = before - (empty & lone[before])
    resampled: np.ndarray = delay[before].astype(np.int64)
    between = empty & (after == before + 1) & (delay[before] != LOST) & (delay[after] != LOST)
    begin, end = before[between], after[between]
    centres = start_ns + period_ns * np.flatnonzero(between) + period_ns // 2
    part = np.clip((centres - sent[begin]) / (sent[end] - sent[begin]), 0.0, 1.0)
    resampled[between] += np.rint(part * (delay[end] - delay[begin])).astype(np.int64)
    return resampled, empty


def _loss_notes(
    way: Way, lost: np.ndarray, empty: np.ndarray, *, lone_losses: bool
) -> Iterator[str]:
    """Notes for the user on the treatment of lost packets, if it is a choice or may surprise."""
    sent, missing = way.counted[0], way.counted[1] or 0
    if lone_losses and missing:
        yield "a single lost packet stands for its own period only (--lone-loss)"
    elif (lost & empty).any():
        yield (
            "a lost packet stands for the time until the next one; with --lone-loss period a "
            "single lost packet stands for its own period only"
        )
    if missing > 0.001 * sent and lost.mean() < missing / sent / 2:
        yield (
            "fewer periods than packets are lost, as a period is lost only with all its packets; "
            "a shorter --period separates them"
        )


def _gap_note(way: Way, period_ns: int) -> Iterator[str]:
    """A note for the user on a time without packets, if no packet of this way is lost."""
    usual, longest = usual_spacing_ns(way, period_ns), int(np.diff(way.sent_ns).max(initial=0))
    if not way.lost.any() and longest >= max(_GAP * usual, _LEAST_GAP_NS) and usual:
        yield (
            f"no packet is marked as lost, and {longest * 1e-9:.3g} s passed without one, "
            f"{usual * 1e-9:.3g} s usually: the delay is interpolated; were packets lost there?"
        )


def _dense_note(way: Way, period_ns: int) -> Iterator[str]:
    """A note for the user on many packets in a period, as of coarse times or a wrong unit."""
    sent, times = len(way.sent_ns), len(np.unique(way.sent_ns))
    periods = len(np.unique(way.sent_ns // period_ns))
    if sent >= 2 * times and (times == 1 or usual_spacing_ns(way, period_ns) > period_ns):
        yield (
            f"{sent} packets have only {times} time{'s' * (times > 1)} of sending, and of each the "
            "longest delay counts; are the times cut short?"
        )
    elif sent >= _DENSE * periods:
        yield (
            f"{sent} packets in {periods} period{'s' * (periods > 1)}, and of each the longest "
            "delay counts; is the unit of the times right?"
        )


def _quantile_note(way: Way, way_ns: np.ndarray) -> Iterator[str]:
    """A note for the user if the interpolated delays have another high quantile than packets."""
    packets_ns = np.quantile(way.delay_ns[~way.lost], _HIGH)
    periods_ns = np.quantile(way_ns[way_ns != LOST], _HIGH)
    if abs(periods_ns - packets_ns) > _OTHER * packets_ns and len(way.sent_ns) < len(way_ns):
        yield (
            f"{100 * _HIGH:g} % of the packets took at most {packets_ns * 1e-6:.4g} ms, "
            f"{100 * _HIGH:g} % of the periods {periods_ns * 1e-6:.4g} ms, since delays in between "
            "are interpolated"
        )


def _spacing_ns(way: Way, period_ns: int) -> float:
    """The usual time between packets, or the mean one if a period has several [ns]."""
    mean = float(way.sent_ns[-1] - way.sent_ns[0]) / max(len(way.sent_ns) - 1, 1)
    usual = usual_spacing_ns(way, period_ns)
    return usual if usual > period_ns else mean


def _binned(series: Series, start_ns: int, n: int, period_ns: int) -> np.ndarray:
    index = (series.time_ns - start_ns) // period_ns
    inside = (index >= 0) & (index < n)
    total = np.bincount(index[inside], weights=series.values[inside], minlength=n)
    if not series.mean:
        return np.rint(total).astype(np.int64)
    count = np.bincount(index[inside], minlength=n)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _metadata(
    measured: Measured, ways: list[Way | None], n: int, period_ns: int, notes: list[str]
) -> dict[str, Any]:
    known = {d: way for d, way in zip(DIRECTIONS, ways, strict=True) if way is not None}
    rates = {way.rate_hz for way in known.values() if way.rate_hz is not None}
    sizes = {d: w.message_bytes for d, w in known.items() if w.message_bytes is not None}
    return {
        **measured.metadata,
        "packets": {direction: way.counted[0] for direction, way in known.items()},
        "packets_lost": {direction: way.counted[1] for direction, way in known.items()},
        "spacing_ms": {d: round(_spacing_ns(way, period_ns) * 1e-6, 6) for d, way in known.items()},
        "span_s": n * period_ns * 1e-9,
        "period_us": period_ns / 1000,
        **{f"{direction}_bytes": size for direction, size in sizes.items()},
        **({"rate_hz": rates.pop()} if len(rates) == 1 else {}),
        "notes": notes,
    }
