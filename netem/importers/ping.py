"""Logs of `ping`: iputils (also `-D` and `-O`), macOS, the BSDs and busybox, IPv4 and IPv6.

    [1795299931.544576] 64 bytes from 10.0.0.1: icmp_seq=1 ttl=64 time=0.092 ms

A number without a reply is a loss. With `-D` a line tells when the reply came, which is the time of
sending plus the round trip; otherwise pings are an interval apart. Numbers wrap after 65535.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from netem.importers.irtt import HALF_NOTE
from netem.importers.measured import Measured, halved
from netem.importers.options import Options
from netem.importers.resample import MAX_PERIODS, check_span
from netem.importers.source import content_lines, nanoseconds, whole, wrong
from shared.errors import ProfileError

_SECOND = 1_000_000_000
_STAMP = re.compile(r"\[(\d{1,12}(?:\.\d{1,9})?)\]")
_NUMBER = re.compile(r"(?:icmp_|\b)(?:seq|req)[= ](\d+)")
# "time=0.092 ms", and as it is in other languages: "Zeit=0,092 ms".
_TIME = re.compile(r"[=<] ?(\d+(?:[.,]\d+)?) ?ms(?=\s|$)")
# What begins like a reply: "64 bytes from ", or the time that -D puts before it.
_REPLY = re.compile(r"\s*(?:\[|(?:\d\d:\d\d:\d\d\.\d+ )?\d+ [^\W\d]+ [^\W\d]+ )")
_COMPLAINT = re.compile(
    r"no answer|unreachable|exceeded|redirect|quench|filtered|prohibited", re.IGNORECASE
)
_HEADING = re.compile(r"PING6?[ (]")
_SIZE = re.compile(r"(?:^|\] ?|\s)(\d+) \w+ \w+ ")
_SENT = re.compile(r"\b(\d{1,9}) packets transmitted")
_WRAP = 65536


def is_ping(start: str) -> bool:
    """Whether a file that begins so is a log of pings."""
    return any(
        _HEADING.match(line) or (_NUMBER.search(line) and _TIME.search(line))
        for line in start.splitlines()
    )


def read_ping(path: Path, options: Options, direction: int) -> Measured:
    """Both ways, half the round trip each; `ProfileError` with the line that is wrong."""
    trips: dict[int, int] = {}
    came: dict[int, int] = {}
    unanswered: set[int] = set()
    size, transmitted, last, heading = None, None, 0, ""
    for line, text in content_lines(path):
        where = f"line {line}"
        if _HEADING.match(text):
            if heading:
                raise wrong(path, where, f"one run of ping, begun at {heading}", text)
            heading = where
        if heading and (match := _SENT.search(text)):
            transmitted = int(match[1])
        sequence, time = _NUMBER.search(text), _TIME.search(text)
        torn = _REPLY.match(text) and (sequence is None or time is None)
        if torn and not _COMPLAINT.search(text):
            raise wrong(path, where, "a reply as in icmp_seq=1 ttl=64 time=0.092 ms", text)
        if sequence is None:
            continue  # a heading, statistics, a complaint without a number
        wrapped = whole(
            sequence[1], path, where, "a sequence number from 0 to 65535", low=0, high=_WRAP - 1
        )
        last += (
            (wrapped - last + _WRAP // 2) % _WRAP - _WRAP // 2
            if trips or unanswered
            else (wrapped - last)
        )
        unanswered.add(last)
        if time is None or last in trips:
            continue  # lost, or a duplicate
        trips[last] = nanoseconds(
            time[1].replace(",", "."), _SECOND // 1000, path, where, "a round trip in ms"
        )
        if stamp := _STAMP.search(text):
            came[last] = nanoseconds(stamp[1], _SECOND, path, where, "a time in s")
        if size is None and (match := _SIZE.search(text)):
            size = int(match[1][:9])
    if not trips:
        raise ProfileError(f"{path}: expected replies to pings, found none")
    return _measured(path, options, trips, came, _numbers(path, unanswered, transmitted), size)


def _numbers(path: Path, seen: set[int], transmitted: int | None) -> np.ndarray:
    """All numbers that were sent, in order."""
    first, last = min(seen), max(seen)
    if transmitted is not None:
        # iputils counts from 1, the others from 0.
        first, last = min(first, 1), max(last, transmitted - (first == 0))
    if last - first >= MAX_PERIODS:
        raise ProfileError(f"{path}: expected at most {MAX_PERIODS} pings, got {last - first + 1}")
    return np.arange(first, last + 1)


def _measured(
    path: Path,
    options: Options,
    trips: dict[int, int],
    came: dict[int, int],
    numbers: np.ndarray,
    size: int | None,
) -> Measured:
    notes = [HALF_NOTE, "a ping without a reply counts as lost on both ways"]
    answered = np.array(sorted(trips))
    round_trip = np.zeros(len(numbers), dtype=np.int64)
    round_trip[answered - numbers[0]] = [trips[n] for n in answered.tolist()]
    lost = np.ones(len(numbers), dtype=bool)
    lost[answered - numbers[0]] = False
    interval = options.interval_ns
    span = int(numbers[-1] - numbers[0])
    if len(came) == len(trips) > 1:
        times = np.array([came[n] - trips[n] for n in answered.tolist()])
        if interval is None:
            interval = int(np.median(np.diff(times) // np.diff(answered)))
        sent = _along(numbers, answered, times, max(interval, 1))
    else:
        if interval is None:
            interval = _SECOND
            notes.append("no times in the log: pings taken to be 1 s apart; --interval says other")
        check_span(path, span * interval, options.period_ns)
        sent = (numbers - numbers[0]) * interval
    rate_hz = round(_SECOND / interval, 3) if interval > 0 else None
    ways = halved(sent, round_trip, lost, message_bytes=size, rate_hz=rate_hz)
    return Measured(ways, tuple(notes), {"split": "half"})


def _along(
    numbers: np.ndarray, answered: np.ndarray, times: np.ndarray, interval: int
) -> np.ndarray:
    """When each number was sent: unanswered ones between their neighbours, or an interval apart."""
    between = np.interp(numbers, answered, times - times[0])
    before, after = np.minimum(numbers - answered[0], 0), np.maximum(numbers - answered[-1], 0)
    sent: np.ndarray = times[0] + np.rint(between).astype(np.int64) + (before + after) * interval
    return sent
