"""The time that stands before a line of a log: seconds since 1970, a date, or a time of day.

[1795299931.544576] …      as of `ping -D` and `fping -D`
2026-11-14T22:13:20.5+0100 …    [2026-11-14 22:13:20] …    20261114T221320.5 …

Nov 14 22:13:20 …    Tue Nov 14 22:13:20 CET 2026: …    as of `ts` and `date`

11/14/2026 10:13:20 PM - …    14.11.2026 22:13:20 …    only the time of day is read
22:13:20.123 …
"""

from __future__ import annotations

import re

from netem.importers.measured import UNITS_NS
from netem.importers.times import date_time_ns

_CLOCK = r"\d{1,2}:\d\d:\d\d(?:\.\d{1,9}|,\d{3,9}|:(?:\d{6}|\d{3})(?!\d))?(?: ?[AaPp][Mm]\b)?"
_ZONE = r"(?: ?(?:Z\b|UTC\b|GMT\b|[+-]\d\d:?\d\d))?"
_DATE = rf"\d{{4}}[-/.]\d\d?[-/.]\d\d?(?:[T_]| +){_CLOCK}{_ZONE}"
_BASIC = rf"\d{{8}}[T_-]\d{{6}}(?:\.\d{{1,9}})?{_ZONE}"
_UNORDERED = rf"\d\d?[-/.]\d\d?[-/.]\d{{4}},?(?:[T_]| +){_CLOCK}"
_MONTHS = "Jan|Feb|Mar|Apr|May|Jun|Jul|Aug|Sep|Oct|Nov|Dec"
_NAMED = (
    rf"(?:[A-Z][a-z]{{2}},? +)?(?:(?:{_MONTHS}) +\d\d?|\d\d? +(?:{_MONTHS}))"
    rf"(?: +\d{{4}})? +{_CLOCK}"
    r"(?: +(?![A-Z]{4})[A-Z]{2,5}\b)?(?: +\d{4}\b)?"
)
_EPOCH = r"\d{9,10}\.\d{1,9}|\d{9,10}|\d{13}|\d{16}|\d{19}"
_TIME = rf"{_DATE}|{_BASIC}|{_UNORDERED}|{_NAMED}|{_CLOCK}|{_EPOCH}"
# A priority and a version stand before the time of a line of syslog.
_BARE = re.compile(
    rf"\s*(?:<\d{{1,3}}>\d? ?)?({_TIME})(?:\s*[:;,|-])?(?:\s+|(?<=[:;,|]))(?=\S)", re.ASCII
)
_BRACKETED = re.compile(
    rf"\s*\[\s*({_TIME}|\d{{1,12}}(?:\.\d{{1,9}})?)\s*\]\s*[:;,|-]?\s*", re.ASCII
)
# A time that is none of these: another clock, or seconds since the beginning or the line before.
_UNREAD = re.compile(
    r"(?<![\w:.])\d{1,2}:\d\d:\d\d(?![\w:])|^\s*\[?\s*\d{1,8}\.\d{2,9}\s*\]?\s", re.ASCII
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


def unread_time(text: str) -> str:
    """The time in a text that `stamped` does not read; empty without one."""
    match = _UNREAD.search(text)
    return "" if match is None else match[0].strip()


def _time_ns(text: str) -> int | None:
    whole, _, fraction = text.partition(".")
    if text.replace(".", "", 1).isdecimal():
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
    # A log without a year is taken to be of a leap year.
    return date_time_ns(f"{year[0] if year else 1972}-{month}-{day[0]} {clock[0]}")
