"""The transport blocks that ns-3's physical layer received: `RxPacketTrace.txt`, mmWave and NR.

    DL/UL time frame subF slot 1stSym symbol# cellId rnti ccId tbSize mcs rv SINR(dB) corrupt TBler

Blocks have no delays. Beside delays of the same run they give the bytes of the blocks that arrived
whole in each period, and the mean SINR. These bytes are a lower bound of the capacity. The capacity
was larger where the sender had nothing to send.
"""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from netem.importers.measured import UNITS_NS, Measured, Series
from netem.importers.options import Options
from netem.importers.source import content_lines, nanoseconds, number, whole, wrong
from shared.errors import ProfileError

_WAYS = {"ul": ("uplink", "ul"), "dl": ("downlink", "dl")}
_NEEDED = ("time", "rnti", "tbsize", "corrupt")
NOTE = (
    "capacity: the bytes of the transport blocks that arrived whole; where there was nothing to "
    "send the link could have carried more"
)


def is_ns3_phy(first_line: str) -> bool:
    """Return whether a file with this first line is a trace of transport blocks."""
    return {"tbsize", "corrupt"} <= set(_names(first_line))


def refuse_alone(path: Path, options: Options, direction: int) -> Measured:
    """Raise `ProfileError`, because blocks have no delays."""
    raise ProfileError(
        f"{path}: expected delays of packets, got transport blocks of the physical layer; try "
        f"UlPdcpStats.txt DlPdcpStats.txt OUT --phy {path.name}"
    )


def read_phy(path: Path, options: Options) -> dict[str, Series]:
    """Columns `uplink_capacity_bytes`, `sinr_ul_db`, … of the directions that are in the trace."""
    rows = content_lines(path)
    line, header = next(rows, (1, ""))
    names = _names(header)
    missing = [name for name in _NEEDED if name not in names]
    if missing or not is_ns3_phy(header):
        raise wrong(path, f"line {line}", f"a header with {', '.join(_NEEDED)}", header)
    time_at, rnti_at, size_at, corrupt_at = (names.index(name) for name in _NEEDED)
    way_at = names.index("direction") if "direction" in names else 0
    sinr_at = next((k for k, name in enumerate(names) if name.startswith("sinr")), None)
    times = {way: array("q") for way in _WAYS}
    sizes = {way: array("d") for way in _WAYS}
    sinrs = {way: array("d") for way in _WAYS}
    terminals: dict[tuple[int, int], str] = {}
    cell_at = names.index("cellid") if "cellid" in names else None
    for line, text in rows:
        where, cells = f"line {line}", text.split()
        if len(cells) < len(names):
            raise wrong(path, where, f"{len(names)} columns", text)
        way = cells[way_at].lower()
        if way not in _WAYS:
            raise wrong(path, where, "DL or UL", cells[way_at])
        rnti = whole(cells[rnti_at], path, where, "an RNTI", low=0, high=65535)
        cell = 0
        if cell_at is not None:
            cell = whole(cells[cell_at], path, where, "a cell as a number", low=0, high=65535)
        if options.rnti not in (None, rnti) or options.cell not in (None, cell):
            continue
        terminals.setdefault((cell, rnti), f"cell {cell}, RNTI {rnti}")
        if len(terminals) > 1:
            got = "; ".join(terminals.values())
            raise wrong(path, where, "one terminal, or --cell or --rnti to choose one", got)
        size = whole(cells[size_at], path, where, "a size in bytes", low=0, high=2**31)
        corrupt = whole(cells[corrupt_at], path, where, "corrupt as 0 or 1", low=0, high=1)
        times[way].append(nanoseconds(cells[time_at], UNITS_NS["s"], path, where, "a time in s"))
        sizes[way].append(0 if corrupt else size)
        if sinr_at is not None:
            sinrs[way].append(number(cells[sinr_at], path, where, "an SINR in dB"))
    series = {}
    for way, (direction, short) in _WAYS.items():
        if times[way]:
            time_ns = np.array(times[way], dtype=np.int64)
            series[f"{direction}_capacity_bytes"] = Series(time_ns, np.array(sizes[way]))
            if sinrs[way]:
                series[f"sinr_{short}_db"] = Series(time_ns, np.array(sinrs[way]), mean=True)
    if not series:
        raise ProfileError(f"{path}: expected transport blocks, got none")
    return series


def _names(header: str) -> list[str]:
    """The names of the columns in lower case. Older traces leave the first one empty."""
    names = header.lstrip("\ufeff%").lower().split()
    unnamed = bool(names) and not ({"dl/ul", "direction"} & set(names))
    return ["dl/ul", *names] if unnamed else names
