"""Tables of packets whose columns the user names: text of any separator, and parquet.

The columns are `sent` and one of `received`, `delay` (one way) and `rtt` (half each way), or
`uplink` and `downlink`. Without `sent`, rows are `--interval` apart. A column has a name, or a
number from 1 in a table without names. `sec+nanosec` and `date+time` are two columns in one. A unit
stands in the name, as in `pub_time(ms)` or `delay_ms`, or one unit holds for all. Dates and times
of day need none. A packet is lost if its delay is empty, nan, `lost` or the like, or the value of
`--lost`. With a `seq`, the number of each packet, a number that no row has is a lost packet.

With an `id` there are two tables, the sender's and the receiver's. Each has a time and the id of
each packet. The importer knows the headers of two tables: CICV5G's, and irtt's in parquet as
DETERMINISTIC6G publishes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from netem.importers.columns import LOST_NS, Read, lost_flag
from netem.importers.irtt import HALF_NOTE
from netem.importers.measured import (
    Measured,
    halved,
    one_way,
    ordered,
    stepped_back_note,
    unfinished_note,
    without_unfinished,
)
from netem.importers.options import Options
from netem.importers.resemblance import columns_by_names
from netem.importers.sequence import skipped, unwrapped, with_skipped
from netem.importers.source import content_lines, head, wrong
from netem.importers.table_parquet import PARQUET, first_cells, parquet_names, read_parquet
from netem.importers.table_text import header_of, read_text, split_names
from netem.importers.times import bare
from shared.errors import ConfigError, ProfileError

_KNOWN = (
    {"sent": "pub_time(ms)", "received": "sub_time(ms)"},
    {
        "sent": "timestamps.client.send.wall(ns)",
        "received": "timestamps.server.receive.wall(ns)",
    },
)
_MEANINGS = ("received", "delay", "rtt", "uplink", "downlink")
# Names of the column of the packets' numbers.
_SEQUENCE = frozenset(
    (
        *("seq", "seqno", "seqnum", "seq_no", "seq_num", "sequence", "sequence_number"),
        *("icmp_seq", "packet_id", "packet_no", "pkt_id", "msg_id", "counter", "header.seq"),
    )
)
# Names of a column whose values tell several measurements apart, and the most values of one.
_GROUPS = frozenset(
    (
        *("direction", "dir", "way", "host", "target", "destination", "dst", "ip", "address"),
        *("ue", "ue_id", "imsi", "rnti", "device", "robot", "flow", "flow_id", "run", "session"),
    )
)
_MANY = 50
# Numbers that step back more often than this count something else.
_OUT_OF_ORDER = 0.05
# The minimum distance of the mark of a lost packet from every delay [units].
_APART = 3
# The least ratio of a mark such as 9999 to the longest delay.
_FAR = 5


def known_columns(path: Path, start: bytes, first_line: str) -> Mapping[str, str]:
    """The columns by meaning of a table whose header is known; empty if it is not known."""
    names = parquet_names(path) if start.startswith(PARQUET) else split_names(first_line)
    for columns in _KNOWN:
        if all(name in names or bare(name) in names for name in columns.values()):
            return columns
    return {}


def read_table(path: Path, options: Options, direction: int) -> Measured:
    """The directions that the columns give. `ProfileError` names the row that is wrong."""
    columns = options.columns or _columns_of(path)
    if "id" in columns:
        return _joined(path, options, direction)
    others = tuple(key for key in columns if key not in ("sent", "seq"))
    timed = "sent" in columns or options.interval_ns is not None
    if not timed or not others or any(key not in _MEANINGS for key in others):
        raise ConfigError(
            f"{path}: columns: expected sent=NAME (or --interval) and received=, delay=, rtt= or "
            "uplink= and downlink=, as in --columns 'sent=pub_time(ms),received=sub_time(ms)', got "
            f"{','.join(f'{key}={name}' for key, name in columns.items()) or 'none'}"
            f"{'' if columns else _advice(path)}"
        )
    read = _read(path, columns, options)
    values, notes = dict(read.values), read.notes
    for key in others:
        _expect_no_mark(path, key, read, options)
        notes += _mark_notes(key, values[key], read.units_ns.get(key), options)
    if "sent" in columns:
        notes += stepped_back_note(values["sent"])
    else:
        interval_ns = options.interval_ns or 0
        values["sent"] = np.arange(len(values[others[0]])) * interval_ns
        notes += (f"rows taken to be {interval_ns * 1e-6:g} ms apart (--interval)",)
    if "seq" in columns:
        numbers = values.pop("seq")
        notes += (f"{skipped(numbers)} packets lost by their numbers ({columns['seq']})",)
        if "sent" not in columns:
            del values["sent"]
        values = with_skipped(path, numbers, values, options.interval_ns)
    elif not any((values[key] == LOST_NS).any() for key in others):
        notes += _skips_note(path, columns, options)
    notes += _groups_note(path, columns, options)
    sent = values["sent"]
    lost = {key: values[key] == LOST_NS for key in others}
    delays = {key: np.where(lost[key], 0, values[key]) for key in others}
    if "rtt" in others:
        ways = halved(sent, delays["rtt"], lost["rtt"])
        return Measured(ways, (HALF_NOTE, *notes), {"split": "half"})
    if "received" in others:
        delays["delay"] = np.where(lost["received"], 0, values["received"] - sent)
        lost["delay"] = lost["received"]
    if "delay" in delays:
        way = ordered(sent, delays["delay"], lost["delay"])
        return replace(one_way(direction, way, *notes), two_clocks=True)
    if set(others) != {"uplink", "downlink"}:
        raise ConfigError(
            f"{path}: columns: expected both uplink= and downlink=, got {', '.join(others)}; name "
            "both"
        )
    up, down = (ordered(sent, delays[key], lost[key]) for key in ("uplink", "downlink"))
    return Measured((up, down), notes, two_clocks=True)


def _joined(path: Path, options: Options, direction: int) -> Measured:
    """One direction, from the sender's and the receiver's table, joined by the ids of packets."""
    receiver = options.beside.get(path)
    if receiver is None:
        raise ProfileError(
            f"{path}: expected two tables to join by id, the sender's and the receiver's, got one; "
            "try SENDER RECEIVER OUT"
        )
    given = options.columns
    keys = [next((k for k in (own, "time") if k in given), "") for own in ("sent", "received")]
    if not all(keys) or not set(given) <= {"id", *keys}:
        raise ConfigError(
            f"{path}: columns: expected a time and an id, got {', '.join(given)}; try --columns "
            "'time=1(ns),id=2', or sent= and received= if the names of the columns differ"
        )
    read = []
    for file, key in zip((path, receiver), keys, strict=True):
        read.append(_read(file, {key: given[key], "id": given["id"]}, options))
    near, far = read
    first = {key: k for k, key in reversed(list(enumerate(near.ids)))}
    if len(first) < len(near.ids):
        twice = next(k for k, key in enumerate(near.ids) if first[key] != k)
        raise wrong(path, near.rows[twice], "an id that no other row has", near.ids[twice])
    sent, times = near.values[keys[0]], far.values[keys[1]]
    arrived: dict[str, int] = {}
    for key, time in zip(far.ids, times.tolist(), strict=True):
        arrived[key] = min(time, arrived.get(key, time))
    came = np.array([arrived.get(key, LOST_NS) for key in near.ids], dtype=np.int64)
    lost = came == LOST_NS
    if lost.all():
        raise ProfileError(
            f"{path}, {receiver}: expected the same ids in both, got none; check the column of the "
            "ids"
        )
    strangers = len(arrived) - int((~lost).sum())
    notes = (*near.notes, *far.notes, *stepped_back_note(sent))
    if strangers:
        notes += (f"left out {strangers} ids that only {receiver.name} has",)
    way, unfinished = without_unfinished(
        ordered(sent, np.where(lost, 0, came - sent), lost), int(times.max())
    )
    notes += unfinished_note(unfinished)
    return replace(one_way(direction, way, *notes), two_clocks=True)


def _columns_of(path: Path) -> Mapping[str, str]:
    start = head(path, size=4)
    first = "" if start == PARQUET else next(content_lines(path), (1, ""))[1]
    return known_columns(path, start, first)


def _advice(path: Path) -> str:
    """Return the columns of a parquet file, with the flags that would read them."""
    if head(path, size=4) != PARQUET:
        return ""
    names = parquet_names(path)
    flags = columns_by_names(names, first_cells(path))
    return f"; it has {', '.join(names)}" + (f": try {flags}" if flags else "")


def _read(path: Path, columns: Mapping[str, str], options: Options) -> Read:
    parquet = head(path, size=4) == PARQUET
    read = (read_parquet if parquet else read_text)(path, columns, options)
    if not len(read.rows):
        raise ProfileError(f"{path}: expected rows below the header, got none")
    return read


def _mark_notes(
    key: str, values: np.ndarray, unit: int | None, options: Options
) -> tuple[str, ...]:
    """Notes on values that may stand for lost packets: exact zeros, and one such as 9999."""
    known = values[values != LOST_NS]
    if key == "received" or not len(known):
        return ()
    notes: tuple[str, ...] = ()
    if none := int((known == 0).sum()):
        flag = lost_flag(options, 0)
        notes = (f"{none} of {len(values)} {key} values are exactly 0; if lost, try {flag}",)
    largest = int(known.max())
    rest, count = known[(known < largest) & (known != 0)], int((known == largest).sum())
    far = len(rest) and unit and largest >= _FAR * max(int(rest.max()), unit)
    if not far or count < 2 or not unit or largest % unit:
        return notes
    mark = largest // unit
    return (
        *notes,
        f"{count} of {len(known)} {key} values are exactly {mark}, the next is "
        f"{rest.max() / unit:g}; if lost, try {lost_flag(options, mark)}",
    )


def _groups_note(path: Path, columns: Mapping[str, str], options: Options) -> tuple[str, ...]:
    """A note on rows of several ways, hosts or terminals that are taken together; empty if none."""
    name = next((each for each in _names(path, columns) if each.lower() in _GROUPS), None)
    if name is None or name in columns.values():
        return ()
    try:
        ids = _read(path, {"id": name}, options).ids
    except ProfileError:
        return ()
    values = list(dict.fromkeys(ids))
    if not 1 < len(values) <= _MANY:
        return ()
    return (
        f"the column {name} has {len(values)} values ({', '.join(values[:4])}"
        f"{', …' * (len(values) > 4)}), and their rows are taken together; give a file of one",
    )


def _names(path: Path, columns: Mapping[str, str]) -> list[str]:
    """The names of all columns; empty if the user counts them."""
    parquet = head(path, size=4) == PARQUET
    return parquet_names(path) if parquet else header_of(path, columns)


def _skips_note(path: Path, columns: Mapping[str, str], options: Options) -> tuple[str, ...]:
    """A note on numbers of packets that skip some; empty without a column of such numbers."""
    name = next((each for each in _names(path, columns) if each.lower() in _SEQUENCE), None)
    if name is None:
        return ()
    try:
        numbers = _read(path, {"seq": name}, options).values["seq"]
    except ProfileError:
        return ()
    steps = np.diff(unwrapped(numbers))
    missing = skipped(numbers)
    if not missing or (steps < 0).mean() > _OUT_OF_ORDER or np.median(steps) != 1:
        return ()
    return (
        f"the numbers in {name} skip {missing} of {missing + len(numbers)} packets; if these were "
        f"lost, add seq={name} to --columns",
    )


def _expect_no_mark(path: Path, key: str, read: Read, options: Options) -> None:
    """Raise `ProfileError` if one value below all others, such as −1, stands for lost packets."""
    values, unit = read.values[key], read.units_ns.get(key)
    known = values[values != LOST_NS]
    low = known[known <= 0] if key == "received" else known[known < 0]
    if unit is None or not len(low) or low.min() != low.max() or low[0] % unit:
        return
    # Exact zeros may be another mark.
    rest, mark = known[(known > low[0]) & (known != 0)], int(low[0]) // unit
    if (len(low) > 1 or mark in (-1, 0)) and len(rest) and rest.min() > low[0] + _APART * unit:
        where = read.rows[int(np.flatnonzero(values == low[0])[0])]
        raise ProfileError(
            f"{path}, {where}: expected {key} as a time, got {mark}, as in {len(low)} of "
            f"{len(values)} rows and with no other {'negative ' * (mark < 0)}value near it; try "
            f"{lost_flag(options, mark)} if these were lost"
        )
