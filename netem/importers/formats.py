"""The formats by name, and the format of a file by its content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from netem.importers.capture_files import is_capture
from netem.importers.distribution import read_histogram, read_netem_table
from netem.importers.flent import is_flent, read_flent
from netem.importers.irtt import is_irtt, read_irtt
from netem.importers.mahimahi import read_cellreplay, read_mahimahi
from netem.importers.measured import Measured
from netem.importers.ns3 import is_ns3, read_ns3
from netem.importers.ns3_phy import is_ns3_phy, refuse_alone
from netem.importers.options import Options
from netem.importers.ping import is_ping, read_ping
from netem.importers.resemblance import refuse_others, resemblance
from netem.importers.source import decoded, head
from netem.importers.table import known_columns, read_table
from netem.profile_file import CSV_HEADER
from shared.errors import ProfileError, one_of

_HEAD_BYTES = 1 << 16
# The options of every measurement of single packets.
_PACKETS = ("pause", "lone_loss", "period")
Read = Callable[[Path, Options, int], Measured]


@dataclass(frozen=True)
class Format:
    """A file format. `read` is None for the project's own format and for captures (in pairs).

    `options` are the flags that it takes. With `either_way`, one file serves both ways.
    """

    name: str
    help: str
    read: Read | None
    options: tuple[str, ...] = ()
    either_way: bool = False


PROFILE = Format("profile", "the project's own .npz or .csv", None)
PCAP = Format("pcap", "captures at both ends", None, ("clock", "robot", *_PACKETS))
FORMATS = (
    Format(
        "ns3",
        "ns-3 *PdcpStats, *RlcStats, Nr*RxStats",
        read_ns3,
        ("rnti", "imsi", "cell", "phy", *_PACKETS),
    ),
    Format("ns3-phy", "ns-3 RxPacketTrace, for --phy", refuse_alone, ("rnti", "cell", "period")),
    Format("irtt", "irtt's JSON", read_irtt, ("clock", *_PACKETS)),
    Format("flent", "Flent's .flent.gz", read_flent, ("columns", *_PACKETS)),
    Format("ping", "a log of ping", read_ping, ("interval", *_PACKETS)),
    Format(
        "mahimahi",
        "a packet-delivery trace",
        read_mahimahi,
        ("load", "base_delay", "queue", "duration", "period"),
    ),
    Format("cellreplay", "packet trains", read_cellreplay, ("load", "pause", "period")),
    Format(
        "netem",
        "a distribution table of tc-netem",
        read_netem_table,
        ("delay", "jitter", "correlation", "duration", "seed", "period"),
        either_way=True,
    ),
    Format("histogram", "delays by bin", read_histogram, ("duration", "seed", "period")),
    Format(
        "table",
        "columns that --columns names",
        read_table,
        ("columns", "unit", "lost", "interval", "clock", *_PACKETS),
    ),
    PCAP,
    PROFILE,
)


def format_named(name: str) -> Format:
    """The format of that name. `ProfileError` lists all names if the name is unknown."""
    for each in FORMATS:
        if each.name == name:
            return each
    raise ProfileError(f"format: {one_of((each.name for each in FORMATS), name)}")


def format_of(path: Path, options: Options) -> Format:
    """The format of a file. `ProfileError` if its content matches no format."""
    return format_named(_name(path, options))


def _name(path: Path, options: Options) -> str:
    start = head(path, size=_HEAD_BYTES)
    if is_capture(start):
        return "pcap"
    if path.suffix == ".npz" and start.startswith(b"PK"):
        return "profile"
    refuse_others(path, start)
    if start.startswith(b"PAR1"):
        return "table"
    text = decoded(start)
    content = [
        line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(start) == _HEAD_BYTES and len(content) > 1:
        content.pop()  # cut in two
    first = content[0] if content else ""
    if is_irtt(text):
        return "irtt"
    if is_flent(path, text):
        return "flent"
    if [cell.strip() for cell in first.split(",")[:2]] == list(CSV_HEADER):
        return "profile"
    if is_ns3_phy(first):
        return "ns3-phy"
    if is_ns3(first):
        return "ns3"
    if "<histogram" in text or "<bin " in text:
        return "histogram"
    if options.columns or known_columns(path, start, first):
        return "table"
    if is_ping(text):
        return "ping"
    if name := _of_numbers(content):
        return name
    like = resemblance(content)
    advice = like or "--format says which, --columns names the columns of any other table"
    raise ProfileError(
        f"{path}: expected one of {', '.join(each.name for each in FORMATS)}, got other content; "
        f"{advice}"
    )


def _of_numbers(content: list[str]) -> str | None:
    """The format of a file of whole numbers: a sign, one per line, or several per line."""
    rows = [line.split() for line in content[:1000]]
    cells = [cell for row in rows for cell in row]
    if not cells or not all(cell.lstrip("-").isdecimal() for cell in cells):
        return None
    if any(cell.startswith("-") for cell in cells):
        return "netem"
    if all(len(row) == 1 for row in rows):
        times = [int(cell[:18]) for cell in cells]
        return "mahimahi" if times == sorted(times) else None
    return "cellreplay" if all(len(row) >= 3 for row in rows) else None
