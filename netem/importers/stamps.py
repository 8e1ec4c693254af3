"""The time that stands before a line of a log: seconds since 1970, a date, or a time of day.

[1795299931.544576] …      as of `ping -D` and `fping -D`
2026-11-14T22:13:20.5+0100 …    and [2026-11-14 22:13:20] …
Nov 14 22:13:20 …    Tue Nov 14 22:13:20 CET 2026: …    as of `ts` and `date`
22:13:20.123 …
"""

from __future__ import annotations

import re

from netem.importers.measured import UNITS_NS
from netem.importers.times import date_time_ns

_CLOCK = r"\d{1,2}:\d\d:\d\d(?:\.\d{1,9}|,\d{3,9})?"
_DATE = rf"\d{{4}}[-/.]\d\d?[-/.]\d\d?(?:[T_]| +){_CLOCK}(?: ?(?:Z\b|UTC\b|GMT\b|[+-]\d\d:?\d\d))?"
_MONTHS = "Jan|Feb|Mar|Apr|May|Jun|Jul|Aug|Sep|Oct|Nov|Dec"
_NAMED = (
    rf"(?:[A-Z][a-z]{{2}},? +)?(?:(?:{_MONTHS}) +\d\d?|\d\d? +(?:{_MONTHS}))"
    rf"(?: +\d{{4}})? +{_CLOCK}"
    r"(?: +[AP]M\b)?(?: +(?![A-Z]{4})[A-Z]{2,5}\b)?(?: +\d{4}\b)?"
)
_EPOCH = r"\d{9,10}\.\d{1,9}|\d{9,10}|\d{13}|\d{16}|\d{19}"
_TIME = rf"{_DATE}|{_NAMED}|{_CLOCK}|{_EPOCH}"
_BARE = re.compile(rf"\s*({_TIME})(?:\s*[:;,|-])?(?:\s+|(?<=[:;,|]))(?=\S)", re.ASCII)
_BRACKETED = re.compile(
    rf"\s*\[\s*({_TIME}|\d{{1,12}}(?:\.\d{{1,9}})?)\s*\]\s*[:;,|-]?\s*", re.ASCII
)
# The unit [ns] by the number of digits of a time since 1970 in ms, µs or ns.
_DIGITS_NS = {13: UNITS_NS["ms"], 16: UNITS_NS["us"], 19: 1}


def stamped(line: str) -> tuple[int | None, str]:
    """The time before a line [ns], None if there is none, and the line without it."""
    match = _BRACKETED.match(line) or _BARE.match(line)
    if match is None:
        return None, line
    time = _time_ns(match[1])
    return (None, line) if time is None else (time, line[match.end() :])


def _time_ns(text: str) -> int | None:
    whole, _, fraction = text.partition(".")
    if whole.isdecimal():
        unit = _DIGITS_NS.get(len(whole), UNITS_NS["s"])
        return int(whole) * unit + int(fraction.ljust(9, "0") or 0)
    named = re.search(_MONTHS, text)
    if named is None:
        return date_time_ns(text)
    year = re.search(r"\b\d{4}\b", text)
    day = re.search(r"(?<![\d:.,])\d\d?(?![\d:])", text)
    clock = re.search(_CLOCK, text)
    assert day is not None
    assert clock is not None
    month = _MONTHS.split("|").index(named[0]) + 1
    half = re.search(r" ([AP])M\b", text)
    hour, _, rest = clock[0].partition(":")
    hours = int(hour) if half is None else int(hour) % 12 + 12 * (half[1] == "P")
    # A log without a year is taken to be of a leap year.
    return date_time_ns(f"{year[0] if year else 1972}-{month}-{day[0]} {hours}:{rest}")
