"""The rows of ns-3's files about bearers: their columns, and the terminal of each row.

A file has a header, or none, as mmWave writes it. Without a header the shape of a row tells:

    Rx 0.1005 1 1 3 100 500000     event, time in s, cell, RNTI, LCID, size; of Rx the delay in ns
    0.1005 1 1 1 3 100 500000      the same of receptions only, with the IMSI behind the cell

The IMSI identifies a terminal. Without an IMSI, the cell and the RNTI do. Two cells may use the
same RNTI, and a terminal gets another RNTI at a handover.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from netem.importers.options import Options
from netem.importers.source import content_lines, nanoseconds, whole, wrong
from shared.errors import ProfileError

_DATA_LCID = 3
EPOCH = ("start", "end", "lcid", "ntxpdus", "nrxpdus", "delay")
EVENT = ("type", "time", "lcid", "size", "delay")
RECEPTION = ("time", "lcid", "packetsize", "delay")
SENDING = ("time", "lcid", "packetsize")
_SHAPES = (EPOCH, EVENT, RECEPTION, SENDING)
_NUMBER = r"\d+(?:\.\d+)?(?:e-\d+)?"
_HEADLESS = re.compile(
    rf"[TR]x\s+{_NUMBER}(?:\s+\d+){{4,6}}\s*|\d+\.\d+(?:e-\d+)?(?:\s+\d+){{6}}\s*"
)
_TOLD = 8
_IN_WORDS = {"cellid": "cell", "imsi": "IMSI", "rnti": "RNTI"}
_FLAGS = {"cellid": "--cell", "imsi": "--imsi", "rnti": "--rnti"}


@dataclass(frozen=True)
class Layout:
    """The names of the columns, in order, and their shape. `headless`: the file has no header."""

    names: list[str]
    shape: tuple[str, ...]
    headless: bool


def layout(first_line: str) -> Layout | None:
    """The columns of a file with this first line; None if the file is not about bearers."""
    names = _names(first_line)
    for shape in _SHAPES:
        if {*shape, "rnti"} <= set(names):
            return Layout(names, shape, headless=False)
    if _HEADLESS.fullmatch(first_line) is None:
        return None
    cells = first_line.split()
    if cells[0] not in ("Tx", "Rx"):
        names = ["time", "cellid", "imsi", "rnti", "lcid", "packetsize", "delay"]
        return Layout(names, RECEPTION, headless=True)
    imsi = ["imsi"] * (len(cells) - (cells[0] == "Rx") - 6)
    names = ["type", "time", "cellid", *imsi, "rnti", "lcid", "size", "delay"]
    return Layout(names, EVENT, headless=True)


class Row(NamedTuple):
    """A row: its place in the file, and its cells in the order of the shape."""

    where: str
    cells: list[str]


def rows(path: Path, options: Options, shape: tuple[str, ...]) -> Iterator[Row]:
    """The rows of one terminal's data bearers. `ProfileError` if the file has several or none."""
    below = content_lines(path)
    first, header = next(below, (1, ""))
    found = layout(header)
    assert found is not None
    names = found.names
    # Names come twice (min, max): the first is the delay's.
    columns = [names.index(name) for name in shape]
    owner = [(name, names.index(name)) for name in ("cellid", "imsi", "rnti") if name in names]
    chosen: dict[str, int | None] = {
        "cellid": options.cell,
        "imsi": options.imsi,
        "rnti": options.rnti,
    }
    mine: dict[tuple[int, ...], str] = {}
    every: dict[tuple[int, ...], str] = {}
    for line, text in itertools.chain([(first, header)] * found.headless, below):
        where, cells = f"line {line}", text.split()
        if found.headless and cells[0] == "Tx":
            cells.append("0")
        if len(cells) < len(names):
            raise wrong(path, where, f"{len(names)} columns", text)
        row = [cells[column] for column in columns]
        lcid = whole(row[shape.index("lcid")], path, where, "an LCID", low=0, high=255)
        who: dict[str, int] = {
            name: whole(cells[at], path, where, f"{_IN_WORDS[name]} as a number", low=0, high=2**63)
            for name, at in owner
        }
        if lcid < _DATA_LCID:
            continue
        key = (who["imsi"],) if who.get("imsi") else (who.get("cellid", 0), who["rnti"])
        every.setdefault(key, ", ".join(f"{_IN_WORDS[name]} {n}" for name, n in who.items()))
        if any(chosen[name] not in (None, who.get(name)) for name in chosen):
            continue
        mine.setdefault(key, every[key])
        if len(mine) == 1:
            yield Row(where, row)
    if len(mine) > 1:
        raise ProfileError(
            f"{path}: expected one terminal, got {len(mine)}: {_listed(mine)}; choose by "
            f"{' or '.join(_FLAGS[name] for name, _ in owner)}"
        )
    if not mine:
        there = f"; there are {_listed(every)}" if every else ""
        asked = ", ".join(f"{_IN_WORDS[k]} {n}" for k, n in chosen.items() if n is not None)
        raise ProfileError(
            f"{path}: expected rows of a data bearer (LCID ≥ {_DATA_LCID})"
            f"{' of ' * bool(asked)}{asked}, found none{there}"
        )


def delay_ns(text: str, unit_ns: int, path: Path, where: str, what: str) -> int:
    """Return a delay in units of `unit_ns` as ns; `ProfileError` if it is negative."""
    delay = nanoseconds(text, unit_ns, path, where, what)
    if delay < 0:
        raise wrong(path, where, what, text)
    return delay


def _listed(terminals: dict[tuple[int, ...], str]) -> str:
    told = list(terminals.values())[:_TOLD]
    more = len(terminals) - len(told)
    return "; ".join(told) + (f" and {more} more" if more else "")


def _names(header: str) -> list[str]:
    """The names of the columns in lower case, without units and the mark of a comment."""
    return [name.split("(")[0].lower() for name in header.lstrip("\ufeff% \t").split()]
