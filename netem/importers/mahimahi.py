"""Traces of a link's capacity: Mahimahi, and the packet trains of CellReplay.

Mahimahi: one whole millisecond per line. Each line is an opportunity to carry 1500 bytes. The
trace begins again at its last time. Bytes of several packets share an opportunity. An opportunity
that finds no bytes is wasted. C(t) is the number of bytes that the link could carry until t.
Message m of L bytes, sent at a_m, has left when C reaches F_m = max(F_{m-1}, C(a_m)) + L.
Message by message this is D(t) = min over s ≤ t of A(s) + C(t) − C(s). A message that would
overfill the queue is lost.

CellReplay: `time_ms base_delay_ms p0 p1 …` per line. A train of packets is sent at that time. The
first packet is under way for the base delay. Packet k arrives p_k ms after the first.
"""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from netem.importers.measured import Measured, Series, one_way, ordered
from netem.importers.options import Load, Options
from netem.importers.resample import MAX_PERIODS, check_span
from netem.importers.source import content_lines, whole, wrong
from netem.profile import DIRECTIONS
from shared.errors import ProfileError

_MS = 1_000_000
_OPPORTUNITY_BYTES = 1500
_TRAIN_PACKET_BYTES = 1400
_MAX_MS = 2**40
_DIGITS = 12
_AT_LEAST_MS = 10_000


def read_mahimahi(path: Path, options: Options, direction: int) -> Measured:
    """The delays of a load over this trace. `ProfileError` names the line that is wrong."""
    if options.load is None:
        raise ProfileError(
            f"{path}: expected a --load for a trace of capacity (opportunities to send 1500 B), "
            "got none; try --load 1000B@500Hz/1000B@1kHz (uplink/downlink), or for a list of "
            "delays --columns 'rtt=1(ms)' --interval 10ms"
        )
    load, times = options.load[direction], _opportunities(path, options)
    cycle = int(times[-1])
    carried = np.cumsum(np.bincount(times)) * _OPPORTUNITY_BYTES
    # One pass, or enough passes for ten seconds.
    duration_ns = options.duration_ns or -(-_AT_LEAST_MS // cycle) * cycle * _MS
    check_span(path, duration_ns, options.period_ns)
    sent = _sending_times(path, load, duration_ns)
    finish = _finish(sent // _MS, load.size, carried, cycle, options.queue_bytes)
    lost = finish < 0
    cycles, rest = (finish - 1) // carried[-1], (finish - 1) % carried[-1] + 1
    left = np.minimum(cycles * cycle + np.searchsorted(carried, rest), _MAX_MS) * _MS
    base = options.base_delay_ns[direction] if options.base_delay_ns else 0
    way = ordered(
        sent,
        np.where(lost, 0, left - sent + base),
        lost,
        message_bytes=load.size,
        rate_hz=load.rate_hz,
    )
    capacity = _capacity(times, cycle, duration_ns // _MS)
    name = DIRECTIONS[direction]
    notes = [
        f"{name}: {load.size} B at {load.rate_hz:g} Hz through a FIFO queue of "
        f"{options.queue_bytes} B, on top of {base * 1e-6:g} ms (--base-delay)"
    ]
    asked, carries = load.size * load.rate_hz * 8e-6, int(carried[-1]) / cycle * 8e-3
    words = f"the load is {asked:.3g} Mbit/s, the mean of the trace is {carries:.3g} Mbit/s"
    if asked > carries:
        words = f"warning: {words}: the queue fills and drops packets; try a smaller --load"
    notes.append(f"{name}: {words}")
    return one_way(direction, way, *notes, **{f"{name}_capacity_bytes": capacity})


def read_cellreplay(path: Path, options: Options, direction: int) -> Measured:
    """The delay of a message sent in place of each train. `ProfileError` names the wrong line."""
    load = options.load[direction] if options.load else None
    packets = -(-load.size // _TRAIN_PACKET_BYTES) if load else 1
    times, delays, longer = array("q"), array("q"), 0
    for line, text in content_lines(path):
        where, cells = f"line {line}", text.split()
        if len(cells) < 3:
            raise wrong(path, where, "time_ms base_delay_ms and the train's arrivals", text)
        time, base, *train = (
            whole(cell, path, where, "whole milliseconds", low=0, high=_MAX_MS) for cell in cells
        )
        if times and time * _MS < times[-1]:
            raise wrong(path, where, "a time not before the last line's", cells[0])
        arrival = float(max(train[:packets]))
        if packets > len(train):
            longer += 1
            arrival *= (packets - 1) / max(len(train) - 1, 1)
        times.append(time * _MS)
        delays.append(base * _MS + round(arrival * _MS))
    if not times:
        raise ProfileError(
            f"{path}: expected lines of time_ms base_delay_ms and arrivals, got none"
        )
    notes = [
        f"{DIRECTIONS[direction]}: delay of the packet number {packets} of a train "
        f"(--load says of what size; {_TRAIN_PACKET_BYTES} bytes a packet)"
    ]
    if longer:
        notes.append(f"{longer} trains are shorter and continue at their pace")
    way = ordered(times, delays, message_bytes=load.size if load else None)
    return one_way(direction, way, *notes)


def _opportunities(path: Path, options: Options) -> np.ndarray:
    """Times of one pass [ms], in order."""
    times = array("q")
    last = 0
    for line, text in content_lines(path):
        # A trace has millions of lines, and few are wrong: make the place only for an error.
        digits = text.strip()
        time = int(digits) if digits.isdecimal() and len(digits) <= _DIGITS else -1
        if not last <= time <= MAX_PERIODS:
            raise wrong(
                path,
                f"line {line}",
                f"one time in whole ms, from the last line's {last} to {MAX_PERIODS}",
                text,
            )
        times.append(time)
        last = time
    if not last:
        raise ProfileError(
            f"{path}: expected opportunities up to a time later than 0 ms, got none after 0 ms"
        )
    return np.array(times, dtype=np.int64)


def _sending_times(path: Path, load: Load, duration_ns: int) -> np.ndarray:
    count = int(duration_ns * 1e-9 * load.rate_hz)
    if not 1 <= count <= MAX_PERIODS:
        raise ProfileError(
            f"{path}: expected from 1 to {MAX_PERIODS} messages, got {count} at {load.rate_hz:g} "
            f"Hz in {duration_ns * 1e-9:g} s; try another --duration or --load"
        )
    sent: np.ndarray = np.rint(np.arange(count) * (1e9 / load.rate_hz)).astype(np.int64)
    return sent


def _finish(
    sent_ms: np.ndarray, size: int, carried: np.ndarray, cycle: int, queue_bytes: int
) -> np.ndarray:
    """F of each message [bytes that could be carried since the start]; −1 where it is lost."""
    total = int(carried[-1])
    # The opportunities of the millisecond of sending have passed.
    passed = (sent_ms // cycle * total + carried[sent_ms % cycle]).tolist()
    finish = np.full(len(passed), -1, dtype=np.int64)
    last = 0
    for m, before in enumerate(passed):
        if last - before + size > queue_bytes and last > before:
            continue
        last = max(last, before) + size
        finish[m] = last
    return finish


def _capacity(times: np.ndarray, cycle: int, until_ms: int) -> Series:
    """The bytes of the opportunities of all passes before `until_ms`, one value per ms."""
    once = np.bincount(times, minlength=cycle + 1) * float(_OPPORTUNITY_BYTES)
    every = np.arange(max(until_ms, 1))
    capacity = once[every % cycle]
    capacity[cycle::cycle] += once[cycle]
    return Series(every * _MS, capacity)
