"""Flent's data files, `.flent.gz`: number, time and round trip [ms] of each ping of a series.

    {"metadata": …, "raw_values": {"Ping (ms) ICMP": [{"seq": 1, "t": 1436735904.4, "val": 50.1}, …

The time is that of the reply. A missing number is a loss, as in a log of `ping -D`. Series without
numbers are means over a step, and the importer ignores them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from netem.importers.measured import UNITS_NS, Measured
from netem.importers.options import Options
from netem.importers.ping import PingLog, measured_pings
from netem.importers.source import json_document, nanoseconds, whole, wrong
from shared.errors import ProfileError

_KEYS = {"seq", "t", "val"}


def is_flent(path: Path, start: str) -> bool:
    """Return whether a file with this beginning is Flent's."""
    return start.lstrip("\ufeff \r\n\t").startswith("{") and (
        ".flent" in path.name or '"x_values"' in start or '"DATA_FILENAME"' in start
    )


def read_flent(path: Path, options: Options, direction: int) -> Measured:
    """Both ways, half the round trip each. `ProfileError` names the value that is wrong."""
    document = json_document(path, "Flent")
    raw = document.get("raw_values") if isinstance(document, dict) else None
    series = (
        {name: values for name, values in raw.items() if _is_of_pings(name, values)}
        if isinstance(raw, dict)
        else {}
    )
    if not series:
        raise ProfileError(
            f"{path}: expected raw values of pings with numbers, got none; try a test of Flent "
            "that pings, as flent rrul"
        )
    chosen = options.columns.get("rtt", next(iter(series)) if len(series) == 1 else "")
    if chosen not in series:
        raise ProfileError(
            f"{path}: expected one series of pings, got {', '.join(series)}; choose one, as in "
            f"--columns 'rtt={next(iter(series))}'"
        )
    log = PingLog(notes=[f"series {chosen}"])
    for k, each in enumerate(series[chosen]):
        where = f"{chosen}, value {k}"
        if not isinstance(each, dict) or not each.keys() >= _KEYS:
            raise wrong(path, where, "a seq, a time t and a val", each)
        try:
            number = int(each["seq"])
        except (TypeError, ValueError, OverflowError):
            raise wrong(path, where, "a whole seq", each["seq"]) from None
        number = whole(str(number), path, where, "a seq", low=0, high=2**40)
        log.seen.add(number)
        if each["val"] is None or number in log.trips:
            continue
        log.trips[number] = nanoseconds(
            str(each["val"]), UNITS_NS["ms"], path, where, "a round trip in ms"
        )
        log.came[number] = nanoseconds(str(each["t"]), UNITS_NS["s"], path, where, "a time in s")
    return measured_pings(path, options, log)


def _is_of_pings(name: str, values: Any) -> bool:
    return (
        name.startswith("Ping (ms)")
        and isinstance(values, list)
        and bool(values)
        and isinstance(values[0], dict)
        and values[0].keys() >= _KEYS
    )
