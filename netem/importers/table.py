"""Tables of packets whose columns the user names: text of any separator, and parquet.

`sent` and one of `received`, `delay` (one way), `rtt` (half each way), or `uplink` and `downlink`.
A unit stands in the name, as in `pub_time(ms)` or `delay_ms`, or is given for all. A packet whose
delay is empty or `lost` was lost. Two tables are known by their header: those of CICV5G, and
irtt's in parquet as DETERMINISTIC6G publishes them.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from netem.importers.irtt import HALF_NOTE
from netem.importers.measured import UNITS_NS, Measured, halved, one_way, ordered
from netem.importers.options import Options
from netem.importers.source import MAX_NS, MAX_RECORDS, content_lines, head, nanoseconds, wrong
from shared.errors import ConfigError, ProfileError

_KNOWN = (
    {"sent": "pub_time(ms)", "received": "sub_time(ms)"},
    {
        "sent": "timestamps.client.send.wall(ns)",
        "received": "timestamps.server.receive.wall(ns)",
    },
)
_MEANINGS = ("received", "delay", "rtt", "uplink", "downlink")
_UNIT = re.compile(r"(?:[(\[_.\s]\s*)(s|ms|us|µs|μs|ns)\s*[)\]]?\s*$")
_LOST = ("", "lost", "none", "null")
_PARQUET = b"PAR1"
_LOST_NS = np.iinfo(np.int64).min


def known_columns(path: Path, start: bytes, first_line: str) -> Mapping[str, str]:
    """What the columns of a table mean whose header is known; empty if it is not."""
    names = _parquet_names(path) if start.startswith(_PARQUET) else _split(first_line)
    for columns in _KNOWN:
        if all(name in names or _bare(name) in names for name in columns.values()):
            return columns
    return {}


def read_table(path: Path, options: Options, direction: int) -> Measured:
    """The ways that the columns say; `ProfileError` with the row that is wrong."""
    parquet = head(path, size=4) == _PARQUET
    first = "" if parquet else next(content_lines(path), (1, ""))[1]
    columns = options.columns or known_columns(path, _PARQUET if parquet else b"", first)
    others = tuple(key for key in columns if key != "sent")
    if "sent" not in columns or not others or any(key not in _MEANINGS for key in others):
        raise ConfigError(
            f"{path}: columns: expected sent=NAME and received=, delay=, rtt= or uplink= and "
            f"downlink=, as in --columns 'sent=pub_time(ms),received=sub_time(ms)', got "
            f"{','.join(f'{key}={name}' for key, name in columns.items()) or 'none'}"
        )
    read = _parquet(path, columns, options) if parquet else _text(path, columns, options)
    sent = read["sent"]
    if not len(sent):
        raise ProfileError(f"{path}: expected rows below the header, found none")
    lost = {key: read[key] == _LOST_NS for key in others}
    delays = {key: np.where(lost[key], 0, read[key]) for key in others}
    if "rtt" in others:
        return Measured(halved(sent, delays["rtt"], lost["rtt"]), (HALF_NOTE,), {"split": "half"})
    if "received" in others:
        delays["delay"] = np.where(lost["received"], 0, read["received"] - sent)
        lost["delay"] = lost["received"]
    if "delay" in delays:
        way = ordered(sent, delays["delay"], lost["delay"])
        return replace(one_way(direction, way), two_clocks=True)
    if set(others) != {"uplink", "downlink"}:
        raise ConfigError(f"{path}: columns: expected both uplink= and downlink=")
    up, down = (ordered(sent, delays[key], lost[key]) for key in ("uplink", "downlink"))
    return Measured((up, down), two_clocks=True)


def _text(path: Path, columns: Mapping[str, str], options: Options) -> dict[str, np.ndarray]:
    rows = content_lines(path)
    line, header = next(rows, (1, ""))
    separator = _separator(header)
    names = _split(header)
    headless = all(re.fullmatch(r"[-+.,\deE]+", name) for name in names)
    places = {
        key: _place(path, f"line {line}", name, names, options.unit, headless=headless)
        for key, name in columns.items()
    }
    values: dict[str, array[int]] = {key: array("q") for key in columns}
    every: Iterator[tuple[int, str]] = iter([(line, header)]) if headless else iter(())
    for source in (every, rows):
        for line, text in source:
            where, cells = f"line {line}", _cells(text, separator)
            if len(cells) < len(names):
                raise wrong(path, where, f"{len(names)} columns", text)
            for key, (at, unit_ns) in places.items():
                cell = cells[at].strip()
                values[key].append(_value(cell, unit_ns, key, separator, path, where))
    return {key: np.array(column, dtype=np.int64) for key, column in values.items()}


def _value(cell: str, unit_ns: int, key: str, separator: str | None, path: Path, where: str) -> int:
    if key != "sent" and cell.lower() in _LOST:
        return int(_LOST_NS)
    text = cell if separator == "," else cell.replace(",", ".")
    return nanoseconds(text, unit_ns, path, where, f"{key} as a number")


def _parquet(path: Path, columns: Mapping[str, str], options: Options) -> dict[str, np.ndarray]:
    import pyarrow as pa
    from pyarrow import parquet

    names = _parquet_names(path)
    read = {}
    for key, name in columns.items():
        at, unit_ns = _place(path, "schema", name, names, options.unit, headless=False)
        try:
            column: Any = parquet.read_table(path, columns=[names[at]]).column(0)
            if not pa.types.is_integer(column.type) and not pa.types.is_floating(column.type):
                raise wrong(path, f"column {names[at]}", "numbers", str(column.type))
            null = column.is_null().to_numpy(zero_copy_only=False)
            cells = column.fill_null(0).to_numpy()
        except (pa.ArrowException, OSError, KeyError, IndexError) as error:
            raise ProfileError(f"{path}: cannot read column {name}: {_one_line(error)}") from None
        if not len(cells):
            raise ProfileError(f"{path}: expected rows, found none")
        whole = cells.dtype.kind in "iu"
        ends = (int if whole else float)(cells.min()), (int if whole else float)(cells.max())
        if not all(abs(end * unit_ns) < MAX_NS for end in ends) or (key == "sent" and null.any()):
            raise wrong(path, f"column {name}", "finite times, none of sending missing", "others")
        times = cells.astype(np.int64) * unit_ns if whole else np.rint(cells * unit_ns)
        read[key] = np.where(null, _LOST_NS, times.astype(np.int64))
    return read


def _parquet_names(path: Path) -> list[str]:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            if file.metadata.num_rows > MAX_RECORDS:
                raise ProfileError(f"{path}: expected at most {MAX_RECORDS} rows")
            return [file.schema.column(k).path for k in range(len(file.schema))]
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ProfileError(f"{path}: expected a parquet file: {_one_line(error)}") from None


def _place(
    path: Path, where: str, name: str, names: list[str], unit: str | None, *, headless: bool
) -> tuple[int, int]:
    """Where a column is, and how many ns its unit has."""
    lower = [each.lower() for each in names]
    lower += [_bare(each) for each in lower]
    found = next((n for n in (name.lower(), _bare(name.lower())) if n in lower), None)
    if headless and name.isdecimal() and 1 <= int(name[:9]) <= len(names):
        at = int(name) - 1
    elif found is None:
        expected = f"a column {name}" + (" (by number, from 1)" if headless else "")
        raise wrong(path, where, expected, ", ".join(names))
    else:
        at = lower.index(found) % len(names)
    match = _UNIT.search(name) or _UNIT.search(names[at])
    written = match[1] if match else unit
    if written not in UNITS_NS:
        raise ConfigError(
            f"{path}: column {name}: expected its unit in its name, as in {name}(ms), or --unit as "
            f"one of {', '.join(list(UNITS_NS)[:3])}, ns; got {written or 'none'}"
        )
    return at, UNITS_NS[written]


def _bare(name: str) -> str:
    """A name without the unit behind it."""
    return re.sub(r"\s*[(\[](s|ms|us|µs|μs|ns)[)\]]$", "", name)


def _separator(header: str) -> str | None:
    """What stands between the columns; None for blanks."""
    return next((mark for mark in "\t;," if mark in header), None)


def _split(header: str) -> list[str]:
    return [cell.strip().strip('"') for cell in _cells(header.lstrip("\ufeff"), _separator(header))]


def _cells(text: str, separator: str | None) -> list[str]:
    if separator is None:
        return text.split()
    if '"' not in text:
        return text.split(separator)
    try:
        return next(csv.reader([text], delimiter=separator))
    except (csv.Error, StopIteration):
        return []


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]
