"""Advice on a file of no known format: the kind of file that it is, or the flags that read it.

The rows identify a table. The names of its columns give the `--columns` that would read it, as far
as they name a time, a delay or a unit.
"""

from __future__ import annotations

import itertools
import re
from pathlib import Path

from netem.importers.source import decoded
from netem.importers.table_text import PREAMBLE, split_names
from netem.importers.times import bare, date_time_ns, unit_ns
from shared.errors import ProfileError

_DELAYS_ALONE = "--columns 'rtt=1(ms)' --interval 10ms"
_IRTT = "irtt client -o FILE.json"
# Other kinds of file: the beginning, the kind, and the advice.
_MAGICS = (
    (b"\xd0\xcf\x11\xe0", "a workbook", "save the sheet as CSV"),
    (b"PK\x03\x04", "a zip archive", "unpack it"),
    (b"\x89HDF", "HDF5", "write its columns as CSV or parquet"),
    (b"SQLite format 3", "a database (rosbag2, too)", "write its columns as CSV or parquet"),
    (b"#ROSBAG", "a rosbag", "write times of sending and receiving as CSV"),
    (b"\x89MCAP", "MCAP", "write times of sending and receiving as CSV"),
    (b"BZh", "compressed by bzip2", "unpack it"),
    (b"\xfd7zXZ", "compressed by xz", "unpack it"),
    (b"\x28\xb5\x2f\xfd", "compressed by zstd", "unpack it"),
    (b"7z\xbc\xaf", "a 7z archive", "unpack it"),
    (b"%PDF", "a PDF", "take the numbers that it is made of"),
)
# Patterns of the names of columns, and their meaning. The first pattern that fits counts.
_NAMES: tuple[tuple[str, str], ...] = (
    ("received", "recv received receive rx sub arrival arrived"),
    ("sent", "sent send tx pub time timestamp ts t date datetime stamp epoch elapsed when start"),
    ("uplink", "uplink ul up u"),
    ("downlink", "downlink dl down"),
    ("rtt", "rtt roundtrip trip ping latency"),
    ("delay", "delay owd oneway latencies d"),
)


def refuse_others(path: Path, start: bytes) -> None:
    """Raise `ProfileError` if the file is of a kind without delays, or with unreadable ones."""
    if b"xl/workbook" in start or b"opendocument.spreadsheet" in start[:200]:
        raise _refusal(path, "a workbook", "save the sheet as CSV")
    for magic, kind, advice in _MAGICS:
        if start.startswith(magic):
            raise _refusal(path, kind, advice)
    text = decoded(start)
    if re.search(r"\bseq=\d+ rtt=[\d.]+[mµu]?s\b", text):
        raise _refusal(path, "irtt's text", f"its JSON, of {_IRTT}")
    if re.search(r'"version":\s*"iperf|^\[ *ID\] Interval|^Connecting to host', text, re.MULTILINE):
        raise _refusal(path, "iperf's sums, without delays of packets", f"ping -D or {_IRTT}")
    if "<FlowMonitor" in text:
        raise _refusal(path, "ns-3's FlowMonitor: sums, no packets", "*PdcpStats.txt")


def _refusal(path: Path, kind: str, advice: str) -> ProfileError:
    return ProfileError(f"{path}: expected delays of packets, got {kind}; try: {advice}")


def resemblance(content: list[str]) -> str:
    """A description of the lines, with the flags that would read them; empty if there is none."""
    rows = [split_names(line) for line in content[:PREAMBLE]]
    if not rows:
        return ""
    numbers = [[_is_number(cell) for cell in row] for row in rows]
    if all(kinds == [True] for kinds in numbers):
        return (
            f"it has one number per line: try {_DELAYS_ALONE} for round trips in ms; or --format "
            "mahimahi for a trace of Mahimahi, with ascending times in whole ms"
        )
    if all(kinds == [True, True] for kinds in numbers):
        return (
            "it has two columns of numbers: try --format histogram for the low of a bin in ms and "
            f"its count; or --columns 'sent=1{_unit(rows[0][0])},rtt=2(ms)' for a time and a round "
            "trip"
        )
    if all(len(row) == 2 and kinds[0] for row, kinds in zip(rows, numbers, strict=True)):
        return (
            "it has a number and a word per line: for the times and the ids of packets, give the "
            f"table of the other end too, and try --columns 'time=1{_unit(rows[0][0])},id=2'"
        )
    for names, row in itertools.pairwise(rows):
        if flags := columns_by_names(names, row):
            return f"it looks like a table: try {flags}"
    return ""


def columns_by_names(names: list[str], row: list[str]) -> str:
    """Return the flags for columns of these names and a row; empty if they tell too little."""
    found: dict[str, str] = {}
    for name, cell in zip(names, row, strict=False):
        date = date_time_ns(cell) is not None
        meaning = _meaning(name) or ("sent" if date else None)
        if meaning is None or meaning in found or _is_number(name):
            continue
        if not date and not _is_number(cell):
            continue
        unit = "" if date or unit_ns(name, name) else "(ms)"
        if unit and meaning in ("sent", "received"):
            unit = _unit(cell)
        found[meaning] = name + unit
    if "uplink" in found and "downlink" not in found and "delay" in found:
        found["downlink"] = found["delay"]
    keys: tuple[str, ...]
    keys = tuple(key for key in ("rtt", "delay", "received") if key in found)[:1]
    if {"uplink", "downlink"} <= found.keys():
        keys = ("uplink", "downlink")
    if not keys:
        return ""
    timed = "sent" in found
    columns = ",".join(f"{key}={found[key]}" for key in (("sent",) * timed + keys))
    return f"--columns '{columns}'" + ("" if timed else " --interval 10ms")


def _meaning(name: str) -> str | None:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare(name))
    words = set(re.findall(r"[a-z]+", spaced.lower()))
    return next((key for key, of in _NAMES if words & set(of.split())), None)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return "_" not in cell


def _unit(cell: str) -> str:
    """The unit in brackets of a time since 1970, by its number of digits; empty for no number."""
    try:
        digits = len(str(int(abs(float(cell)))))
    except ValueError:
        return ""
    return "(ns)" if digits > 17 else "(us)" if digits > 14 else "(ms)" if digits > 11 else "(s)"
