"""Logs of pings: iputils (also `-D` and `-O`), macOS, the BSDs, busybox, fping and Windows.

    [1795299931.544576] 64 bytes from 10.0.0.1: icmp_seq=1 ttl=64 time=0.092 ms
    [1795299931.544576] 10.0.0.1 : [0], 64 bytes, 12.3 ms (12.3 avg, 0% loss)
    Reply from 10.0.0.1: bytes=32 time=87ms TTL=51

A number without a reply is a loss. Windows has no numbers, and every line is a ping. A time before
a line is the arrival of the reply: the time of sending plus the round trip. Without such times
pings are an interval apart. Numbers wrap after 65535, but fping's do not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from netem.importers.irtt import HALF_NOTE
from netem.importers.measured import Measured, halved
from netem.importers.options import Options
from netem.importers.resample import MAX_PERIODS, check_span
from netem.importers.source import content_lines, is_unfinished, lines, nanoseconds, whole, wrong
from netem.importers.stamps import stamped, unread_time
from netem.importers.times import past_midnight
from shared.errors import ProfileError

_SECOND = 1_000_000_000
_NUMBER = re.compile(r"(?:icmp_|\b)(?:seq|req)[= ](\d+)")
# The unit in other scripts, also in an encoding that does not announce itself.
_MS = "(?:ms|毫秒|мсек|мс|ミリ秒|밀리초|\ufffd{1,6})"
# "time=0.092 ms", and the same in other languages: "Zeit=0,092 ms", "时间=9.72 毫秒".
_TIME = re.compile(rf"([=<]) ?(\d+(?:[.,]\d+)?) ?{_MS}(?=\s|$)")
_FPING = re.compile(
    r"(?P<host>\S+)\s*: \[(?P<number>\d+)\], (?:(?P<size>\d+) bytes, (?P<time>[\d.]+) ms|timed out)"
)
# A reply of Windows in any language. With IPv6 the time ends the line: "Reply from ::1: time<1ms".
_WINDOWS = re.compile(rf"[=<] ?\d+ ?{_MS} .*TTL=\d+|: \w+ ?[=<] ?\d+ ?{_MS}\s*$")
_WINDOWS_SENT = re.compile(r"= (\d{1,9})\D+= (\d{1,9})\D+= (\d{1,9}) \(")
# The beginning of a reply: "64 bytes from ", or an unfinished time.
_REPLY = re.compile(r"\s*(?:\[|\d+ [^\W\d]+ [^\W\d]+ )")
_COMPLAINT = re.compile(
    r"no answer|unreachable|exceeded|redirect|quench|filtered|prohibited", re.IGNORECASE
)
_HEADING = re.compile(r"PING6?[ (]")
_SIZE = re.compile(r"^(\d+)[^\d:]+ ")
# "3 packets transmitted, 2 received, 33% packet loss, time 2003ms" in any language. In an address,
# as in fe80::1%eth0, an interface follows the %.
_SENT = re.compile(
    rf"^\D{{0,20}}(\d{{1,9}})\D+\d{{1,9}}\D[^%]*%(?![A-Za-z0-9])(?:.*?(\d{{1,12}}) ?{_MS}\s*$)?"
)
_WRAP = 65536
_STEP_NS = 10_000_000
# By times in whole seconds, a ping that comes later by more than this follows a pause.
_STOOD_NS = 2_500_000_000
# Times of more pings than `_FEW` are none of one clock if more than `_OFTEN` of them step back by
# `_BACK_NS`, or if there are less than `_LEAST_NS` between them.
_FEW, _OFTEN, _BACK_NS, _LEAST_NS = 20, 0.1, 2_000_000, 100_000


@dataclass
class PingLog:
    """The content of a log: round trips [ns] and arrival times of replies by number, and more.

    `unread` is the first time before a reply that is of no known form.
    """

    trips: dict[int, int] = field(default_factory=dict)
    came: dict[int, int] = field(default_factory=dict)
    seen: set[int] = field(default_factory=set)
    size: int | None = None
    transmitted: int | None = None
    took_ns: int | None = None
    unread: str = ""
    notes: list[str] = field(default_factory=list)


def is_ping(start: str) -> bool:
    """Return whether a file with this beginning is a log of pings."""
    texts = [stamped(line)[1] for line in start.splitlines()]
    return _is_windows(texts) or any(
        _HEADING.match(text) or _FPING.match(text) or (_NUMBER.search(text) and _TIME.search(text))
        for text in texts
    )


def read_ping(path: Path, options: Options, direction: int) -> Measured:
    """Both ways, half the round trip each. `ProfileError` names the line that is wrong."""
    windows = _is_windows([stamped(text)[1] for _, text in content_lines(path, comments="")])
    log = _windows(path) if windows else _numbered(path)
    return measured_pings(path, options, log)


def _is_windows(texts: list[str]) -> bool:
    return any(_WINDOWS.search(text) for text in texts) and not any(
        _NUMBER.search(text) or _FPING.match(text) for text in texts
    )


def _numbered(path: Path) -> PingLog:
    log, last, heading, host = PingLog(), 0, "", ""
    for line, written in content_lines(path):
        where, (stamp, text) = f"line {line}", stamped(written)
        if _HEADING.match(text):
            if heading:
                raise _second_run(path, where, f"one run of ping, begun at {heading}", text)
            heading = where
        fping, sequence, time = _FPING.match(text), _NUMBER.search(text), _TIME.search(text)
        if fping:
            if host not in ("", fping["host"]):
                raise _second_run(path, where, f"one host, {host}", fping["host"])
            host, number, trip, size = fping["host"], fping["number"], fping["time"], fping["size"]
        elif sequence:
            number, trip = sequence[1], time[2] if time else None
            size = match[1] if (match := _SIZE.search(text)) else None
        elif heading and (match := _SENT.search(text)):
            log.transmitted = int(match[1])
            log.took_ns = int(match[2]) * _SECOND // 1000 if match[2] else None
            continue
        torn = _REPLY.match(text) and not fping and (sequence is None or time is None)
        if torn and not _COMPLAINT.search(text):
            if is_unfinished(path, line):
                log.notes.append(f"left out {where}, which is unfinished")
                break
            raise wrong(path, where, "a reply as in icmp_seq=1 ttl=64 time=0.092 ms", text)
        if fping:
            last = whole(number, path, where, "a number", low=0, high=2**40)
        elif sequence:
            expected = "a sequence number from 0 to 65535"
            wrapped = whole(number, path, where, expected, low=0, high=_WRAP - 1)
            half = _WRAP // 2 if log.seen else 0
            last += (wrapped - last + half) % _WRAP - half if half else wrapped - last
        else:
            continue  # a heading, statistics, a complaint without a number
        log.seen.add(last)
        if trip is None:
            continue  # lost
        if last in log.trips:
            if "!)" not in text and not fping:
                raise _second_run(path, where, f"one run of ping, with one reply to {last}", text)
            continue  # a duplicate, as "(DUP!)" says
        ms = trip.replace(",", ".")
        log.trips[last] = nanoseconds(ms, _SECOND // 1000, path, where, "a round trip in ms")
        if stamp is not None:
            log.came[last] = stamp
        elif not log.unread:
            log.unread = unread_time(text[: sequence.start()] if sequence else text)
        if log.size is None and size:
            log.size = int(size[:9])
    return log


def _windows(path: Path) -> PingLog:
    """The log of Windows: each line from the heading, or first reply, to a blank line is a ping."""
    log, begun, ended, below = PingLog(), False, False, 0
    for line, written in lines(path):
        where, (stamp, text) = f"line {line}", stamped(written)
        reply = _WINDOWS.search(text)
        if not text.strip():
            ended = ended or bool(log.seen)
        elif ended:
            if reply:
                raise _second_run(path, where, "one run of ping", text)
            match = _WINDOWS_SENT.search(text)
            if match and int(match[1]) != len(log.seen):
                raise wrong(path, where, f"{len(log.seen)} pings sent", text)
        elif reply:
            time = _TIME.search(text)
            assert time is not None
            below += time[1] == "<"
            number = len(log.seen)
            log.seen.add(number)
            ms = time[2].replace(",", ".")
            log.trips[number] = nanoseconds(ms, _SECOND // 1000, path, where, "a round trip in ms")
            if stamp is not None:
                log.came[number] = stamp
            elif not log.unread:
                log.unread = unread_time(text)
        elif begun or log.seen:
            log.seen.add(len(log.seen))
        begun = begun or text.rstrip().endswith(":")
    if len(log.trips) < len(log.seen) and not log.came:
        log.notes.append("Windows waits up to 4 s for a reply: losses may have lasted longer")
    if below:
        log.notes.append(f"{below} round trips below 1 ms count as 1 ms")
    return log


def _second_run(path: Path, where: str, expected: str, got: str) -> ProfileError:
    return ProfileError(f"{wrong(path, where, expected, got)}; cut the log there")


def _numbers(path: Path, seen: set[int], transmitted: int | None) -> np.ndarray:
    """The numbers of all pings sent, in order."""
    first, last = min(seen), max(seen)
    if transmitted is not None:
        # iputils counts from 1, the others from 0.
        first, last = min(first, 1), max(last, transmitted - (first == 0))
    if last - first >= MAX_PERIODS:
        raise ProfileError(f"{path}: expected at most {MAX_PERIODS} pings, got {last - first + 1}")
    return np.arange(first, last + 1)


def measured_pings(path: Path, options: Options, log: PingLog) -> Measured:
    """Both ways of a log, half of each round trip. `ProfileError` if the log has no reply."""
    if not log.trips:
        of = "" if log.transmitted is None else f" of {log.transmitted}"
        raise ProfileError(
            f"{path}: expected a line for each reply, got none{of}; ping a host that answers, "
            "without -q and -f"
        )
    numbers = _numbers(path, log.seen, log.transmitted)
    notes = [HALF_NOTE, "a ping without a reply counts as lost on both ways", *log.notes]
    answered = np.array(sorted(log.trips))
    round_trip = np.zeros(len(numbers), dtype=np.int64)
    round_trip[answered - numbers[0]] = [log.trips[n] for n in answered.tolist()]
    lost = np.ones(len(numbers), dtype=bool)
    lost[answered - numbers[0]] = False
    known = np.array(sorted(log.came))
    came = past_midnight(np.array([log.came[n] for n in known.tolist()], dtype=np.int64))
    times = came - np.array([log.trips[n] for n in known.tolist()], dtype=np.int64)
    coarse = len(known) > 1 and not (came % _SECOND).any()
    interval, said = _interval(options, log, known, times, coarse=coarse)
    if len(known) > 1 and np.ptp(came) and not coarse:
        _expect_clock(path, known, times)
        if interval is None:
            interval = max(int(np.median(np.diff(times) // np.diff(known))), 1)
        times, steps = _without_steps(known, times, interval)
        notes += steps
        sent = _along(numbers, known, times, interval)
    else:
        if interval is None:
            if log.unread:
                raise ProfileError(
                    f"{path}: expected times as in [1700000000.5], 2023-11-14 22:13:20.5 or "
                    f"22:13:20.5 before the replies, got {log.unread!r}; try --interval 10ms"
                )
            interval = _SECOND
            said = "no times in the log: pings taken to be 1 s apart; --interval sets another time"
        if said:
            notes.append(said)
        check_span(path, int(numbers[-1] - numbers[0]) * interval, options.period_ns)
        sent = (numbers - numbers[0]) * interval
        if coarse:
            sent = sent + _stood_before(numbers, known, times, interval)
    rate_hz = round(_SECOND / interval, 3) if interval > 0 else None
    ways = halved(sent, round_trip, lost, message_bytes=log.size, rate_hz=rate_hz)
    return Measured(ways, tuple(notes), {"split": "half"})


def _interval(
    options: Options, log: PingLog, known: np.ndarray, times: np.ndarray, *, coarse: bool
) -> tuple[int | None, str]:
    """The time between pings [ns] and its source, if the times of the replies do not give it."""
    if options.interval_ns is not None:
        return options.interval_ns, ""
    if coarse and _late(known, times, _pace(known, times)).max() > _STOOD_NS:
        interval = _pace(known, times)
        return interval, (
            f"times of whole seconds: pings taken to be {interval * 1e-6:g} ms apart, as mostly"
        )
    if (len(known) < 2 or coarse) and log.took_ns and log.transmitted and log.transmitted > 1:
        interval = log.took_ns // (log.transmitted - 1)
        return interval, f"pings taken to be {interval * 1e-6:g} ms apart, as the summary says"
    if coarse and times[-1] > times[0] + _SECOND // 2:
        interval = int(round((times[-1] - times[0]) / 1e9) * 1e9) // int(known[-1] - known[0])
        return interval, (
            f"times of whole seconds: pings taken to be {interval * 1e-6:g} ms apart, as between "
            "the first and the last"
        )
    return None, ""


def _pace(known: np.ndarray, times: np.ndarray) -> int:
    """The median time between pings, over tenths of a log with times in whole seconds [ns]."""
    m = max(1, len(known) // 10)
    return int(np.median((times[m:] - times[:-m]) / (known[m:] - known[:-m])))


def _late(known: np.ndarray, times: np.ndarray, interval: int) -> np.ndarray:
    """The time from each answered ping to the next one beyond the expected time [ns]."""
    late: np.ndarray = np.diff(times) - np.diff(known) * interval
    return late


def _stood_before(
    numbers: np.ndarray, known: np.ndarray, times: np.ndarray, interval: int
) -> np.ndarray:
    """The time that ping stood still before each number, by times in whole seconds [ns]."""
    late = _late(known, times, interval)
    stood = np.append(0, np.cumsum(np.where(late > _STOOD_NS, late, 0)))
    before = np.maximum(np.searchsorted(known, numbers, side="right") - 1, 0)
    passed: np.ndarray = stood[before]
    return passed


def _expect_clock(path: Path, known: np.ndarray, times: np.ndarray) -> None:
    """Raise `ProfileError` for times that do not go on, as those of `ts -i` since the line before.

    Many of them step back, or they all lie within moments.
    """
    pings = int(known[-1] - known[0])
    back = (np.diff(times) < -_BACK_NS).mean()
    if pings > _FEW and (back > _OFTEN or np.ptp(times) < pings * _LEAST_NS):
        raise ProfileError(
            f"{path}: expected times that go on from ping to ping, got {pings + 1} pings within "
            f"{np.ptp(times) * 1e-9:.3g} s, {100 * back:.0f} % of them before the last one (as of "
            "ts -i); try --interval 10ms on the log without these times"
        )


def _without_steps(
    known: np.ndarray, times: np.ndarray, interval: int
) -> tuple[np.ndarray, list[str]]:
    """The sending times by a clock without steps back [ns], and a note on each step."""
    passed, expected = np.diff(times), np.diff(known) * interval
    back = passed < np.minimum(0, expected - _STEP_NS)
    shifts = np.append(0, np.cumsum(np.where(back, expected - passed, 0)))
    notes = [
        f"the clock was set back by {(expected[k] - passed[k]) * 1e-9:.3g} s before the ping "
        f"number {known[k + 1]}: later times are shifted to go on"
        for k in np.flatnonzero(back)[:3]
    ]
    return times + shifts, notes


def _along(
    numbers: np.ndarray, answered: np.ndarray, times: np.ndarray, interval: int
) -> np.ndarray:
    """The sending time of each number [ns].

    A number without a reply gets a time between its neighbours, or an interval from the first or
    last one.
    """
    between = np.interp(numbers, answered, times - times[0])
    before, after = np.minimum(numbers - answered[0], 0), np.maximum(numbers - answered[-1], 0)
    sent: np.ndarray = times[0] + np.rint(between).astype(np.int64) + (before + after) * interval
    return sent
