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
    (b"\x93NUMPY", "a NumPy array", "numpy.savetxt(FILE, array)"),
    (b"MATLAB 5.0", "MATLAB's variables", "writematrix(array, FILE)"),
    (b"\x80\x04\x95", "a pickle", "write its columns as CSV or parquet"),
    (b"version https://git-lfs", "a pointer of Git LFS", "git lfs pull"),
)
_TABLE = "write times and delays as CSV, a packet a line"
# The same of texts: a pattern of a line.
_TEXTS = tuple(
    (re.compile(pattern, re.MULTILINE), kind, advice)
    for pattern, kind, advice in (
        (r"\bseq=\d+ rtt=[\d.]+[mµu]?s\b", "irtt's text", f"its JSON, of {_IRTT}"),
        (
            r'"version":\s*"iperf|^\[ *ID\] *Interval|^Connecting to host',
            "iperf's sums, without delays of packets",
            f"ping -D or {_IRTT}",
        ),
        ("<FlowMonitor", "ns-3's FlowMonitor: sums, no packets", "*PdcpStats.txt"),
        (r"\A\s*<(?:!DOCTYPE )?html", "a page of the web", "the file itself (its raw form)"),
        (
            r"^(?:\S+ )?\S+ IP6? \S+ > \S+: ",
            "tcpdump's text",
            "captures at both ends by tcpdump -w FILE.pcap",
        ),
        (
            r"^HOST: .*Loss%|\A\s*(?:traceroute6? to|Tracing route to) ",
            "the routes of mtr or traceroute",
            f"ping -D or {_IRTT}",
        ),
        (r"^\S+ +: (?:[\d.]+|-)(?: (?:[\d.]+|-))+$", "fping's lists without times", "fping -D -l"),
        (r'\A\s*\{"(?:resp|timeout)": ', "fping's JSON", "fping -D -l"),
        (r"^SENT \([\d.]+s\) ", "the log of nping", "ping -D"),
        (r"^Flow>\d+ Seq>\d+ ", "the log of D-ITG", _TABLE),
        (r"^seq_no=\d+ +(?:delay=|\*LOST)", "the log of owping", _TABLE),
        (r"^Success rate is \d+ percent", "the sums of a router's ping", "ping -D"),
        (r"^[+r-] [\d.]+ /NodeList/", "ns-3's trace of packets", "*PdcpStats.txt or pcap"),
        (r"\btime=[\d.]+ ?m?sec\b|^Unicast reply from ", "the log of arping", "ping -D"),
        (r"^Probing .* - time=[\d.]+ ?ms", "the log of tcping", "ping -D"),
    )
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
# Names of columns that have sums over packets.
_SUMS = frozenset(
    (
        *("avg", "average", "mean", "median", "min", "max", "std", "stddev", "stdev", "mdev"),
        *("worst", "best", "jitter", "loss"),
    )
)


def refuse_others(path: Path, start: bytes) -> None:
    """Raise `ProfileError` if the file is of a kind without delays, or with unreadable ones."""
    if b"xl/workbook" in start or b"opendocument.spreadsheet" in start[:200]:
        raise _refusal(path, "a workbook", "save the sheet as CSV")
    for magic, kind, advice in _MAGICS:
        if start.startswith(magic):
            raise _refusal(path, kind, advice)
    text = decoded(start)
    if not text.strip():
        raise _refusal(path, "an empty file", "another file")
    for pattern, kind, advice in _TEXTS:
        if pattern.search(text):
            raise _refusal(path, kind, advice)


def _refusal(path: Path, kind: str, advice: str) -> ProfileError:
    return ProfileError(f"{path}: expected delays of packets, got {kind}; try: {advice}")


def resemblance(content: list[str]) -> str:
    """A description of the lines, with the flags that would read them; empty if there is none."""
    if content and re.match(r"\s*[{[]", content[0]):
        return f"it is JSON of no known program: {_TABLE}"
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
    return next(filter(None, itertools.starmap(_unnamed, itertools.pairwise(rows))), "")


def _unnamed(names: list[str], row: list[str]) -> str:
    """Return words on a table whose names do not tell which column has the delays."""
    if len(names) != len(row) or len(names) < 2 or any(_is_number(name) for name in names):
        return ""
    if sums := [name for name in names if _words(name) & _SUMS]:
        return (
            f"it looks like a table of sums ({', '.join(sums[:3])}): a row of each packet is needed"
        )
    if sum(_is_number(cell) or date_time_ns(cell) is not None for cell in row) < 2:
        return ""
    return (
        f"it looks like a table of {', '.join(names[:6])}{', …' * (len(names) > 6)}: name a time "
        "and a delay, as in --columns 'sent=TIME(s),rtt=DELAY(ms)'"
    )


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


def _words(name: str) -> set[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare(name))
    return set(re.findall(r"[a-z]+", spaced.lower()))


def _meaning(name: str) -> str | None:
    words = _words(name)
    if words & _SUMS:
        return None
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
