"""Times as text: units in the names of columns, dates, times of day.

A date without a zone is read as UTC, because only differences of times matter. A date such as
11/12/2023 or 11.12.2023 does not tell the day from the month. Only its time of day is read.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone

import numpy as np

from netem.importers.measured import UNITS_NS
from netem.importers.source import MAX_NS

_WORDS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "milli", "millis", "millisec", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micros", "microsec", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
_NS = {word: UNITS_NS[unit] for unit, words in _WORDS.items() for word in words}
_ANY = "|".join(sorted(_NS, key=len, reverse=True))
_BRACKETED = re.compile(rf"\s*[(\[]\s*({_ANY})\s*[)\]]\s*$", re.IGNORECASE)
# `delay_ms`, `delay ms`, `header.stamp.nanosec`, `seconds`, `rttMs`.
_NAMED = re.compile(rf"(?:^|[\s_./-]|(?<=[a-z])(?=[A-Z]))(?i:({_ANY}))$")
# The number and the unit of a cell such as `25.1 ms`.
_WITH_UNIT = re.compile(rf"([-+\d.,eE]*\d) ?({_ANY})", re.IGNORECASE)
_ZONE = r" ?(Z|UTC|GMT|[+-]\d\d:?(?:\d\d)?)?"
_HALF = r"(?: *([AP])\.?M\.?)?"
_CLOCK = rf"(\d{{1,2}}):(\d\d)(?::(\d\d)(?:[.,](\d{{1,9}})\d*|:(\d{{3}}|\d{{6}}))?)?{_HALF}"
_SEPARATOR = r"(?:[T_]| +)"
_DATE_TIME = re.compile(
    rf"(\d{{4}})[-/.](\d\d?)[-/.](\d\d?){_SEPARATOR}{_CLOCK}{_ZONE}", re.ASCII | re.IGNORECASE
)
# The basic format of ISO 8601: 20231114T221320.5Z.
_BASIC = re.compile(
    rf"(\d{{4}})(\d\d)(\d\d)[T_-](\d\d)(\d\d)(\d\d)(?:[.,](\d{{1,9}})\d*)?{_ZONE}", re.ASCII
)
_UNORDERED_DATE = r"\d\d?[-/.]\d\d?[-/.]\d{4},?" + _SEPARATOR
_TIME_OF_DAY = re.compile(rf"(?:{_UNORDERED_DATE})?{_CLOCK}", re.ASCII | re.IGNORECASE)
_DAY_NS = 86_400_000_000_000
DAY_NOTE = "times of day: a time that steps back by half a day or more is on the next day"


def bare(name: str) -> str:
    """The name of a column without the unit in brackets behind it."""
    return _BRACKETED.sub("", name)


def unit_ns(name: str, column: str) -> int | None:
    """The unit [ns] in the user's name of a column, or else in the column's name; or None."""
    match = _BRACKETED.search(name) or _BRACKETED.search(column) or _NAMED.search(column.strip())
    return _NS[match[1].lower()] if match else None


def number_and_unit_ns(text: str) -> tuple[str, int | None]:
    """The number in a cell, and the unit [ns] behind it; None without a unit."""
    # Most cells have none, and there are many.
    match = _WITH_UNIT.fullmatch(text) if text[-1:].isalpha() else None
    return (text, None) if match is None else (match[1], _NS[match[2].lower()])


def date_time_ns(text: str) -> int | None:
    """A date and time as ns since 1970, a time of day as ns since midnight; None for other text.

    It is also None for a date that is more than 146 years from 1970.
    """
    whole: list[str | None]
    if match := _DATE_TIME.fullmatch(text):
        *whole, fraction, digits, half, zone = match.groups()
    elif match := _BASIC.fullmatch(text):
        *whole, fraction, zone = match.groups()
        digits = half = None
    elif (match := _TIME_OF_DAY.fullmatch(text)) and (match[3] or match[6]):
        *clock, fraction, digits, half = match.groups()
        whole, zone = ["1970", "1", "1", *clock], None
    else:
        return None
    try:
        year, month, day, hour, minute, second = (int(part or 0) for part in whole)
        if half:
            hour = hour % 12 + 12 * (half in "Pp")
        moment = datetime(year, month, day, hour, minute, tzinfo=_zone(zone))
        moment += timedelta(seconds=second)
    except (ValueError, OverflowError):
        return None
    passed = moment - datetime(1970, 1, 1, tzinfo=timezone.utc)
    seconds = passed.days * 86_400 + passed.seconds
    time_ns = seconds * UNITS_NS["s"] + int((fraction or digits or "").ljust(9, "0"))
    return time_ns if abs(time_ns) < MAX_NS else None


def is_time_of_day(text: str) -> bool:
    """Return whether only the time of day is read from a text."""
    return _TIME_OF_DAY.fullmatch(text) is not None


def past_midnight(times_ns: np.ndarray) -> np.ndarray:
    """Times of day in order, continued past midnight on one axis, (n,) [ns]."""
    days = np.cumsum(np.diff(times_ns, prepend=times_ns[:1]) < -_DAY_NS // 2)
    moved: np.ndarray = times_ns + days * _DAY_NS
    return moved


def on_day_of(times_ns: np.ndarray, others_ns: np.ndarray) -> np.ndarray:
    """Times of day, moved by whole days as close as possible to other times, (n,) each [ns]."""
    moved: np.ndarray = times_ns + np.rint((others_ns - times_ns) / _DAY_NS).astype(int) * _DAY_NS
    return moved


def _zone(text: str | None) -> timezone:
    if text is None or text[0] not in "+-":
        return timezone.utc
    digits = text[1:].replace(":", "")
    ahead = timedelta(hours=int(digits[:2]), minutes=int(digits[2:] or 0))
    return timezone(-ahead if text[0] == "-" else ahead)
