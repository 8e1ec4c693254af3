"""Times as text: units in the names of columns, dates, times of day.

A date without a zone is read as UTC, because only differences of times matter.
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
_ZONE = r" ?(Z|UTC|GMT|[+-]\d\d:?(?:\d\d)?)?"
_CLOCK = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d{1,9})\d*)?)?"
_DATE_TIME = re.compile(rf"(\d{{4}})[-/.](\d\d?)[-/.](\d\d?)(?:[T_]| +){_CLOCK}{_ZONE}", re.ASCII)
_TIME_OF_DAY = re.compile(_CLOCK, re.ASCII)
_DAY_NS = 86_400_000_000_000
DAY_NOTE = "times of day: a time that steps back by half a day or more is on the next day"


def bare(name: str) -> str:
    """The name of a column without the unit in brackets behind it."""
    return _BRACKETED.sub("", name)


def unit_ns(name: str, column: str) -> int | None:
    """The unit [ns] in the user's name of a column, or else in the column's name; or None."""
    match = _BRACKETED.search(name) or _BRACKETED.search(column) or _NAMED.search(column.strip())
    return _NS[match[1].lower()] if match else None


def date_time_ns(text: str) -> int | None:
    """A date and time as ns since 1970, a time of day as ns since midnight; None for other text.

    It is also None for a date that is more than 146 years from 1970.
    """
    match = _DATE_TIME.fullmatch(text)
    if match is not None:
        *date, hour, minute, second, fraction, zone = match.groups()
    else:
        match = _TIME_OF_DAY.fullmatch(text)
        if match is None or match[3] is None:
            return None
        hour, minute, second, fraction = match.groups()
        date, zone = ["1970", "1", "1"], None
    try:
        year, month, day = (int(part) for part in date)
        moment = datetime(year, month, day, int(hour), int(minute), tzinfo=_zone(zone))
        moment += timedelta(seconds=int(second or 0))
    except (ValueError, OverflowError):
        return None
    whole = moment - datetime(1970, 1, 1, tzinfo=timezone.utc)
    seconds = whole.days * 86_400 + whole.seconds
    time_ns = seconds * UNITS_NS["s"] + int((fraction or "").ljust(9, "0"))
    return time_ns if abs(time_ns) < MAX_NS else None


def is_time_of_day(text: str) -> bool:
    """Return whether a text is a time of day without a date."""
    return _TIME_OF_DAY.fullmatch(text) is not None


def past_midnight(times_ns: np.ndarray) -> np.ndarray:
    """Times of day in order, continued past midnight on one axis, (n,) [ns]."""
    days = np.cumsum(np.diff(times_ns, prepend=times_ns[:1]) < -_DAY_NS // 2)
    moved: np.ndarray = times_ns + days * _DAY_NS
    return moved


def _zone(text: str | None) -> timezone:
    if text is None or text[0] not in "+-":
        return timezone.utc
    digits = text[1:].replace(":", "")
    ahead = timedelta(hours=int(digits[:2]), minutes=int(digits[2:] or 0))
    return timezone(-ahead if text[0] == "-" else ahead)
