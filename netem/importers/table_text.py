"""Tables as text: any separator, a header in one of the first lines or none."""

from __future__ import annotations

import csv
import itertools
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from netem.importers.columns import (
    LOST_NS,
    TIMES,
    Read,
    found_in,
    place_of,
    sequence_number,
    units_ns,
    value_ns,
)
from netem.importers.options import Options
from netem.importers.source import content_lines, lines, wrong
from netem.importers.times import (
    DAY_NOTE,
    bare,
    is_time_of_day,
    on_day_of,
    past_midnight,
    unit_ns,
)
from shared.errors import ProfileError

# The maximum number of lines in which the importer looks for a header.
PREAMBLE = 50


def read_text(path: Path, columns: Mapping[str, str], options: Options) -> Read:
    where, header, names = _header(path, columns)
    separator = _separator(header)
    first = next((row for row in content_lines(path) if row[0] > where), (where, ""))
    if names and _are_units(units := split_names(first[1]), columns, names):
        where = first[0]
        names = [f"{name} [{unit.strip('[]() ')}]" for name, unit in zip(names, units, strict=True)]
    below = (row for row in content_lines(path) if row[0] > where)
    places = {
        key: place_of(path, f"line {where}", name, names, options.unit, split_names(header))
        for key, name in columns.items()
    }
    # With blanks as separators, a missing cell would move all cells behind it.
    width = 1 + max(max(place.at) for place in places.values())
    width = len(names) if names and separator is None else width
    values: dict[str, array[int]] = {key: array("q") for key in columns if key != "id"}
    ids: list[str] = []
    numbers = array("q")
    clock: set[str] = set()
    notes: tuple[str, ...] = ()
    for line, text in below:
        try:
            cells = _cells(text, separator)
            if len(cells) < width:
                raise wrong(path, f"line {line}", f"{width} columns", text)
            row = {}
            for key, place in places.items():
                written = [cells[at].strip() for at in place.at]
                if key == "id":
                    ids.append(written[0])
                    continue
                if key == "seq":
                    row[key] = sequence_number(written[0], path, f"line {line}")
                    continue
                row[key] = value_ns(written, place, key, separator, options, path, f"line {line}")
                if key in TIMES and ":" in written[-1] and is_time_of_day(" ".join(written)):
                    clock.add(key)
        except ProfileError:
            if names or len(numbers) or line > PREAMBLE:
                raise
            del ids[len(numbers) :]
            notes = (f"{path.name}: left out the lines above the first row of numbers",)
            continue
        for key, value in row.items():
            values[key].append(value)
        numbers.append(line)
    read = {key: np.array(column, dtype=np.int64) for key, column in values.items()}
    for key in clock:
        known = read[key] != LOST_NS
        read[key][known] = past_midnight(read[key][known])
    if {"sent", "received"} <= clock:
        known = read["received"] != LOST_NS
        read["received"][known] = on_day_of(read["received"][known], read["sent"][known])
    notes += (DAY_NOTE,) * bool(clock)
    return Read(read, _Lines(numbers), units_ns(places), ids, notes)


class _Lines(Sequence[str]):
    """The numbers of lines in words."""

    def __init__(self, numbers: array[int]) -> None:
        self._numbers = numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, k: Any) -> Any:
        return f"line {self._numbers[k]}"


def header_of(path: Path, columns: Mapping[str, str]) -> list[str]:
    """The names of all columns; empty if the user counts them."""
    return _header(path, columns)[2]


def _header(path: Path, columns: Mapping[str, str]) -> tuple[int, str, list[str]]:
    """The header's line, text and names; line 0 and no names if the user counts columns."""
    wanted = [part.strip() for name in columns.values() for part in (name, *name.split("+"))]
    first = (1, "")
    for line, text in itertools.islice(lines(path), PREAMBLE):
        bared = text.lstrip("#% ")
        if not bared.strip():
            continue
        first = first if first[1] else (line, text)
        names = split_names(bared)
        found = [name for name in columns.values() if found_in(name, names)]
        if len(found) == len(columns):
            return line, bared, names
    if all(bare(name).isdecimal() or not bare(name) for name in wanted if "+" not in name):
        *_, below = (first[1], *(t for _, t in itertools.islice(content_lines(path), PREAMBLE)))
        return 0, below, []
    missing = next(name for name in columns.values() if not found_in(name, split_names(first[1])))
    raise wrong(path, f"line {first[0]}", f"a column {missing}", ", ".join(split_names(first[1])))


def _are_units(cells: list[str], columns: Mapping[str, str], names: list[str]) -> bool:
    """Return whether the row below the header has the units of the columns that are asked for."""
    asked = {at for name in columns.values() for at in found_in(name, names)}
    return len(cells) == len(names) and all(
        unit_ns("", f"[{cells[at].strip('[]() ')}]") for at in asked
    )


def _separator(header: str) -> str | None:
    """The separator of the columns; None for blanks."""
    return next((mark for mark in "\t;,|" if mark in header), None)


def split_names(header: str) -> list[str]:
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
