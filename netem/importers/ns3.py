"""Delays that ns-3 writes per bearer: mmWave and LENA `*PdcpStats`, `*RlcStats`, 5G-LENA `Nr*Rx*`.

Three shapes, told apart by their header, two of them under one name (attribute `AggregatedStats`):

    % start end CellId IMSI RNTI LCID nTxPDUs … delay stdDev min max …    per epoch, delay in s
    TYPE TIME CellId IMSI RNTI LCID SIZE DELAY    Tx and Rx events, time in s, delay in ns
    time(s) cellId rnti lcid packetSize delay(s)  receptions

A reception tells the time of sending, TIME − DELAY. A Tx event of a time at which no reception was
sent is a loss; the times have six digits. Data are on the bearers LCID ≥ 3. The PDCP delay is that
of the radio link: the core network and the hosts' links are not in it.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from netem.importers.measured import (
    UNITS_NS,
    Measured,
    one_way,
    ordered,
    unfinished_note,
    without_unfinished,
)
from netem.importers.options import Options
from netem.importers.resample import check_span
from netem.importers.source import content_lines, nanoseconds, whole, wrong
from shared.errors import ProfileError

_DATA_LCID = 3
_S = UNITS_NS["s"]
_EPOCH = ("start", "end", "rnti", "lcid", "ntxpdus", "nrxpdus", "delay")
_EVENT = ("type", "time", "rnti", "lcid", "size", "delay")
_RECEPTION = ("time", "rnti", "lcid", "packetsize", "delay")


def is_ns3(first_line: str) -> bool:
    """Whether a file that begins with this line is one of these."""
    names = _names(first_line)
    return any(set(shape) <= set(names) for shape in (_EPOCH, _EVENT, _RECEPTION))


def read_ns3(path: Path, options: Options, direction: int) -> Measured:
    """The packets of one way; `ProfileError` with the line that is wrong."""
    rows = content_lines(path)
    line, header = next(rows, (1, ""))
    names = _names(header)
    readers: list[tuple[tuple[str, ...], Callable[[_Table, Options, int], Measured]]] = [
        (_EPOCH, _epochs),
        (_EVENT, _events),
        (_RECEPTION, _receptions),
    ]
    for shape, read in readers:
        if set(shape) <= set(names):
            # Names come twice (min, max): the first is the delay's.
            columns = [names.index(name) for name in shape]
            return read(_Table(path, rows, columns, len(names), options.rnti), options, direction)
    raise wrong(
        path,
        f"line {line}",
        "a header of ns-3: % start end … delay, TYPE TIME … DELAY or time(s) … delay(s)",
        header,
    )


@dataclass
class _Table:
    """The rows of data bearers of one terminal, each cut down to the columns asked for."""

    path: Path
    lines: Iterator[tuple[int, str]]
    columns: list[int]
    width: int
    rnti: int | None

    def rows(self, rnti_column: int, lcid_column: int) -> Iterator[tuple[str, list[str]]]:
        """Where a row is and its cells."""
        found: set[str] = set()
        for line, text in self.lines:
            where, cells = f"line {line}", text.split()
            if len(cells) < self.width:
                raise wrong(self.path, where, f"{self.width} columns", text)
            row = [cells[column] for column in self.columns]
            lcid = whole(row[lcid_column], self.path, where, "an LCID", low=0, high=255)
            rnti = whole(row[rnti_column], self.path, where, "an RNTI", low=0, high=65535)
            if lcid < _DATA_LCID or self.rnti not in (None, rnti):
                continue
            found.add(row[rnti_column])
            if len(found) > 1:
                raise wrong(
                    self.path, where, "one terminal, or --rnti to choose one", f"RNTI {rnti}"
                )
            yield where, row
        if not found:
            chosen = "" if self.rnti is None else f" of RNTI {self.rnti}"
            raise ProfileError(
                f"{self.path}: expected rows of a data bearer (LCID ≥ {_DATA_LCID}){chosen}, "
                "found none"
            )


def _epochs(table: _Table, options: Options, direction: int) -> Measured:
    path, period_ns = table.path, options.period_ns
    pieces = []
    total = 0
    for where, row in table.rows(2, 3):
        start, end = (nanoseconds(cell, _S, path, where, "a time in s") for cell in row[:2])
        if end <= start:
            raise wrong(path, where, "an end after the start", f"{row[0]} … {row[1]}")
        sent, received = (
            whole(cell, path, where, "a count of PDUs", low=0, high=10**12) for cell in row[4:6]
        )
        delay = _delay(row[6], _S, path, where, "a delay in s")
        if sent or received:
            total += end - start
            check_span(path, total, period_ns)
            times = np.arange(start, end, period_ns)
            pieces.append((times, np.full(len(times), delay), np.full(len(times), not received)))
    if not pieces:
        raise ProfileError(f"{path}: expected epochs in which data were sent, found none")
    way = ordered(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))
    return one_way(
        direction,
        way,
        f"{path.name}: means over epochs: an outage shorter than an epoch is smoothed away, and a "
        "loss shows only if a whole epoch was lost; per packet: AggregatedStats=false",
    )


def _events(table: _Table, options: Options, direction: int) -> Measured:
    path, end = table.path, 0
    # By size: several PDUs are sent at one time.
    sendings: dict[int, list[int]] = defaultdict(list)
    origins: dict[int, list[int]] = defaultdict(list)
    untimed: dict[int, list[int]] = defaultdict(list)
    sent, delays = array("q"), array("q")
    for where, row in table.rows(2, 3):
        time = nanoseconds(row[1], _S, path, where, "a time in s")
        size = whole(row[4], path, where, "a size in bytes", low=0, high=2**31)
        delay = _delay(row[5], 1, path, where, "a delay in whole ns")
        end = max(end, time)
        if row[0].lower() == "tx":
            sendings[size].append(time)
        elif row[0].lower() != "rx":
            raise wrong(path, where, "Tx or Rx", row[0])
        elif delay:
            origins[size].append(time - delay)
            sent.append(time - delay)
            delays.append(delay)
        else:
            untimed[size].append(time)
    if not delays:
        raise ProfileError(f"{path}: expected Rx rows with a delay, found none")
    lost = [
        time
        for size, times in sendings.items()
        for time in _unanswered(sorted(times), sorted(origins[size]), sorted(untimed[size]))
    ]
    way = ordered([*sent, *lost], [*delays, *lost], np.arange(len(sent) + len(lost)) >= len(sent))
    way, unfinished = without_unfinished(way, end)
    notes = unfinished_note(unfinished)
    left_out = sum(len(times) for times in untimed.values())
    if left_out:
        notes += (f"{path.name}: {left_out} PDUs without a delay left out",)
    return one_way(direction, way, *notes)


def _receptions(table: _Table, options: Options, direction: int) -> Measured:
    path = table.path
    times, delays = array("q"), array("q")
    for where, row in table.rows(1, 2):
        delays.append(_delay(row[4], _S, path, where, "a delay in s"))
        times.append(nanoseconds(row[0], _S, path, where, "a time in s") - delays[-1])
    note = f"{path.name}: only packets that arrived are in it: losses are not known"
    return one_way(direction, ordered(times, delays), note)


def _unanswered(sendings: list[int], origins: list[int], untimed: list[int]) -> list[int]:
    """The times of sending of which there is no reception; all of one size, in order [ns].

    `origins` are the times of sending of what was received. What RLC sends for itself or a second
    time is received without one, at the times `untimed`: it is what was last sent before.
    """
    missing = []
    j = 0
    for time in sendings:
        # Six digits: two times of one event differ by at most one unit of the last.
        tolerance = 1.5 * 10 ** max(math.floor(math.log10(max(time, 1))) - 5, 0)
        while j < len(origins) and origins[j] < time - tolerance:
            j += 1
        if j < len(origins) and origins[j] <= time + tolerance:
            j += 1
        else:
            missing.append(time)
    for time in reversed(untimed):
        before = bisect_right(missing, time)
        if before:
            del missing[before - 1]
    return missing


def _delay(text: str, unit_ns: int, path: Path, where: str, what: str) -> int:
    delay = nanoseconds(text, unit_ns, path, where, what)
    if delay < 0:
        raise wrong(path, where, what, text)
    return delay


def _names(header: str) -> list[str]:
    """Names of the columns in lower case, without units and the mark of a comment."""
    return [name.split("(")[0].lower() for name in header.lstrip("\ufeff% \t").split()]
