"""Delays that ns-3 writes per bearer: mmWave and LENA `*PdcpStats`, `*RlcStats`, 5G-LENA `Nr*`.

The header tells four shapes apart. Two of them share a name (attribute `AggregatedStats`).

    % start end CellId IMSI RNTI LCID nTxPDUs … delay stdDev min max …    per epoch, delay in s

    TYPE TIME CellId IMSI RNTI LCID SIZE DELAY    Tx and Rx events, time in s, delay in ns

    time(s) cellId rnti lcid packetSize delay(s)  receptions
    time(s) cellId rnti lcid packetSize           sendings, beside receptions

A reception gives the time of sending, TIME − DELAY. A Tx event, or a sending, without a reception
of that sending time is a loss. The times have six digits. Data are on the bearers LCID ≥ 3. The
PDCP delay is that of the radio link, without the core network and the hosts' links.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
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
from netem.importers.ns3_epochs import read_epochs
from netem.importers.ns3_rows import EPOCH, EVENT, RECEPTION, SENDING, delay_ns, layout, rows
from netem.importers.options import Options
from netem.importers.source import content_lines, first_line, nanoseconds, whole, wrong
from shared.errors import ProfileError

_S = UNITS_NS["s"]


def is_ns3(line: str) -> bool:
    """Return whether a file with this first line has one of the four shapes."""
    return layout(line) is not None


def is_ns3_sendings(line: str) -> bool:
    """Return whether a file with this first line has sendings only."""
    found = layout(line)
    return found is not None and found.shape == SENDING


def read_ns3(path: Path, options: Options, direction: int) -> Measured:
    """The packets of one direction. `ProfileError` names the line that is wrong."""
    line, header = next(content_lines(path), (1, ""))
    found = layout(header)
    if found is None:
        raise wrong(
            path,
            f"line {line}",
            "a header of ns-3: % start end … delay, TYPE TIME … DELAY or time(s) … delay(s)",
            header,
        )
    if found.shape == EPOCH:
        return read_epochs(path, rows(path, options, EPOCH), options, direction)
    if found.shape == EVENT:
        return _events(path, options, direction)
    if found.shape == RECEPTION:
        return _receptions(path, options, direction, headless=found.headless)
    raise ProfileError(
        f"{path}: expected ns-3's receptions, got its sendings, which have no delays; give both, "
        f"as in {path.name.replace('Tx', 'Rx')} {path.name} OUT"
    )


def _events(path: Path, options: Options, direction: int) -> Measured:
    end = 0
    # By size: several PDUs are sent at one time.
    sendings: dict[int, list[int]] = defaultdict(list)
    origins: dict[int, list[int]] = defaultdict(list)
    untimed: dict[int, list[int]] = defaultdict(list)
    sent, delays = array("q"), array("q")
    for where, row in rows(path, options, EVENT):
        time = nanoseconds(row[1], _S, path, where, "a time in s")
        size = whole(row[3], path, where, "a size in bytes", low=0, high=2**31)
        delay = delay_ns(row[4], 1, path, where, "a delay in whole ns")
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
        raise ProfileError(f"{path}: expected Rx rows with a delay, got none")
    lost = _missing(sendings, origins, untimed)
    way = ordered([*sent, *lost], [*delays, *lost], np.arange(len(sent) + len(lost)) >= len(sent))
    way, unfinished = without_unfinished(way, end)
    notes = unfinished_note(unfinished)
    left_out = sum(len(times) for times in untimed.values())
    if left_out:
        notes += (f"{path.name}: left out {left_out} PDUs without a delay",)
    return one_way(direction, way, *notes)


def _receptions(path: Path, options: Options, direction: int, *, headless: bool) -> Measured:
    times, delays = array("q"), array("q")
    origins: dict[int, list[int]] = defaultdict(list)
    end = 0
    unit_ns, unit = (1, "whole ns") if headless else (_S, "s")
    for where, row in rows(path, options, RECEPTION):
        delays.append(delay_ns(row[3], unit_ns, path, where, f"a delay in {unit}"))
        received = nanoseconds(row[0], _S, path, where, "a time in s")
        end = max(end, received)
        times.append(received - delays[-1])
        size = whole(row[2], path, where, "a size in bytes", low=0, high=2**31)
        origins[size].append(times[-1])
    sendings = options.beside.get(path) or _sibling(path)
    if sendings is None:
        note = f"{path.name}: has only the packets that arrived: losses are unknown"
        way = ordered(times, delays)
        return one_way(direction, replace(way, counts=(len(way.sent_ns), None)), note)
    sent = _sendings(sendings, options)
    lost = _missing(sent, origins, {})
    order = np.arange(len(times) + len(lost)) >= len(times)
    end = max(end, *(max(each) for each in sent.values()))
    way = ordered([*times, *lost], [*delays, *lost], order)
    way, unfinished = without_unfinished(way, end)
    note = f"{path.name}: the packets of {sendings.name} that did not arrive are lost"
    return one_way(direction, way, note, *unfinished_note(unfinished))


def _sibling(path: Path) -> Path | None:
    """The file of sendings that belongs by name to a file of receptions; None without one."""
    sibling = path.with_name(path.name.replace("Rx", "Tx"))
    there = sibling != path and sibling.is_file() and is_ns3_sendings(first_line(sibling))
    return sibling if there else None


def _sendings(path: Path, options: Options) -> dict[int, list[int]]:
    """Times of sending by size [ns]."""
    sent: dict[int, list[int]] = defaultdict(list)
    for where, row in rows(path, options, SENDING):
        size = whole(row[2], path, where, "a size in bytes", low=0, high=2**31)
        sent[size].append(nanoseconds(row[0], _S, path, where, "a time in s"))
    return sent


def _missing(
    sendings: Mapping[int, list[int]],
    origins: Mapping[int, list[int]],
    untimed: Mapping[int, list[int]],
) -> list[int]:
    """The sending times of the PDUs that did not arrive [ns]. The arguments are by size."""
    return [
        time
        for size, times in sendings.items()
        for time in _unanswered(
            sorted(times), sorted(origins.get(size, ())), sorted(untimed.get(size, ()))
        )
    ]


def _unanswered(sendings: list[int], origins: list[int], untimed: list[int]) -> list[int]:
    """The sending times without a reception; all of one size, in order [ns].

    `origins` are the sending times of the PDUs received. RLC's own PDUs and retransmissions arrive
    without a sending time, at the times `untimed`. Each is the PDU last sent before.
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
