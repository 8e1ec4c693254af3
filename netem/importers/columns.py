"""Columns of tables: the columns that a user names, and the values of their cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from netem.importers.options import Options
from netem.importers.source import nanoseconds, whole, wrong
from netem.importers.times import bare, date_time_ns, number_and_unit_ns, unit_ns
from shared.errors import ConfigError, ProfileError

LOST_NS = int(np.iinfo(np.int64).min)
TIMES = ("sent", "received", "time")
_LOST = frozenset(
    (
        *("", "lost", "loss", "none", "null", "nan", "-nan", "na", "n/a", "#n/a", "-", "--", "*"),
        *("timeout", "timed out", "request timed out", "no reply", "unreachable", "failed"),
        *("inf", "+inf", "infinity", "∞"),
    )
)


@dataclass(frozen=True)
class Place:
    """The column or columns that together hold a value, and their units [ns]."""

    at: tuple[int, ...]
    units_ns: tuple[int | None, ...]


@dataclass
class Read:
    """Values [ns] by meaning, `LOST_NS` for a lost packet.

    `rows` has the place of each value in the file, `ids` the ids of the packets. `units_ns` has the
    unit [ns] of each meaning whose values are numbers.
    """

    values: dict[str, np.ndarray]
    rows: Sequence[str]
    units_ns: Mapping[str, int | None]
    ids: list[str] = field(default_factory=list)
    notes: tuple[str, ...] = ()


def found_in(name: str, names: list[str]) -> list[int]:
    """The indices of a column, or of several columns joined by `+`; empty if one is missing."""
    lower = [each.lower() for each in names]
    bared = [bare(each) for each in lower]
    for parts in ([name], name.split("+")):
        at = []
        for part in (part.strip().lower() for part in parts):
            among = lower if part in lower else bared
            key = part if part in among else bare(part)
            if key in among:
                at.append(among.index(key))
        if len(at) == len(parts):
            return at
    return []


def place_of(
    path: Path, where: str, name: str, names: list[str], unit: str | None, first: list[str]
) -> Place:
    """The place of a column, with its unit [ns]."""
    at = found_in(name, names)
    parts = name.split("+") if len(at) != 1 else [name]
    if not names:
        at = [int(bare(part)[:9]) - 1 for part in parts]
        if not all(0 <= k < len(first) for k in at):
            raise wrong(path, where, f"a column {name} (by number, from 1)", ", ".join(first))
    for part, k in zip(parts, at, strict=True) if names else ():
        _expect_one(path, where, part.strip(), names[k], names)
    given = None
    if unit is not None:
        given = unit_ns("", unit.strip())
        if given is None:
            raise ConfigError(f"{path}: --unit: expected its unit as s, ms, us or ns, got {unit!r}")
    columns = [names[k] if names else "" for k in at]
    units = [unit_ns(part, column) for part, column in zip(parts, columns, strict=True)]
    return Place(tuple(at), tuple(own or given for own in units))


def _expect_one(path: Path, where: str, asked: str, found: str, names: list[str]) -> None:
    """Raise `ProfileError` if a name means several columns."""
    exact = asked.lower() == found.lower()
    kinds = [(each if exact else bare(each)).lower() for each in names]
    alike = [k for k, kind in enumerate(kinds) if kind == kinds[names.index(found)]]
    if len(alike) > 1:
        others = " and ".join(f"{names[k]} (column {k + 1})" for k in alike)
        raise ProfileError(
            f"{path}, {where}: expected one column {asked}, got {others}; try the whole name, or "
            "count all columns, as in sent=1(s),rtt=3(ms)"
        )


def units_ns(places: Mapping[str, Place]) -> dict[str, int | None]:
    return {key: place.units_ns[0] for key, place in places.items() if len(place.at) == 1}


def value_ns(
    written: list[str],
    place: Place,
    key: str,
    separator: str | None,
    options: Options,
    path: Path,
    where: str,
) -> int:
    cell = " ".join(written)
    if key not in ("sent", "time") and is_lost(cell, options):
        return int(LOST_NS)
    if key in TIMES and (":" in cell or "T" in cell):
        time = date_time_ns(cell)
        if time is None:
            raise wrong(path, where, f"{key} as in 2023-11-14 22:13:20.5", cell)
        return time
    total = 0
    for text, named in zip(written, place.units_ns, strict=True):
        digits, own = number_and_unit_ns(text)
        unit = own or named
        if unit is None:
            raise ConfigError(
                f"{path}, {where}: {key}: expected its unit in its name, as in NAME(ms), or --unit "
                f"as one of s, ms, us, ns; got {cell!r} without one"
            )
        number = digits if separator == "," else digits.replace(",", ".")
        total += nanoseconds(number, unit, path, where, f"{key} as a number")
    return total


def sequence_number(text: str, path: Path, where: str) -> int:
    """The number of a packet in a cell."""
    whole_part, _, rest = text.partition(".")
    if rest.strip("0"):
        raise wrong(path, where, "seq as a whole number", text)
    return whole(whole_part, path, where, "seq as a whole number", low=0, high=2**62)


def is_lost(cell: str, options: Options) -> bool:
    """Return whether the cell of a delay stands for a lost packet."""
    if cell.lower() in _LOST or cell in options.lost:
        return True
    for mark in options.lost:
        try:
            if float(cell) == float(mark):
                return True
        except ValueError:
            continue
    return False


def lost_flag(options: Options, mark: int) -> str:
    """The flag that makes a further value stand for lost packets."""
    marks = (*options.lost, str(mark))
    return f"--lost {mark}" if len(marks) == 1 else f"--lost={','.join(marks)}"
