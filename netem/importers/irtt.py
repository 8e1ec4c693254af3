"""The file of `irtt client -o FILE.json`: round trips, and one-way delays by two clocks [ns].

`lost` is a string, "false", "true", "true_up" or "true_down" (a truth value in some versions). An
unknown delay has no key. A packet lost on the way up was never sent down. If a packet is lost on
the way down, its delay up is unknown.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from netem.importers.measured import Measured, Way, halved, ordered, stepped_back_note
from netem.importers.options import Options
from netem.importers.source import json_document, wrong
from shared.errors import ProfileError

_MAX_NS = 2**61
_LOST = ("false", "true", "true_up", "true_down")
HALF_NOTE = "round trips: each way has half of each"


def is_irtt(start: str) -> bool:
    """Return whether a file with this beginning is irtt's."""
    return start.lstrip("\ufeff \r\n\t").startswith("{") and (
        '"irtt"' in start or '"round_trips"' in start
    )


def read_irtt(path: Path, options: Options, direction: int) -> Measured:
    """The measurement of both ways. `ProfileError` names the round trip that is wrong."""
    document = json_document(path, "irtt")
    trips = document.get("round_trips") if isinstance(document, dict) else None
    if not isinstance(trips, list) or not trips:
        raise ProfileError(f"{path}: expected irtt's JSON with a list of round_trips, got none")
    parameters = _at(document, "config", "params")
    interval, length = (_at(parameters, key) for key in ("interval", "length"))
    traffic: dict[str, Any] = {
        "rate_hz": 1e9 / interval if _is_time(interval) and interval > 0 else None,
        "message_bytes": length if _is_time(length) else None,
    }
    rows = [_row(path, k, trip) for k, trip in enumerate(trips)]
    sent = _sending_times(path, rows, interval)
    lost = np.array([row["lost"] for row in rows])
    nowhere = "a packet lost in an unknown direction counts as lost in both"
    notes = (*((nowhere,) if (lost == "true").any() else ()), *stepped_back_note(sent))
    one_way = all(row["lost"] != "false" or row["send"] is not None for row in rows)
    if one_way and options.clock != "half":
        ways = _ways(rows, sent, lost, traffic)
        return Measured(ways, notes, {"split": "one-way"}, two_clocks=True)
    _need_round_trips(path, rows)
    trip = np.array([row["rtt"] or 0 for row in rows])
    # Each half leaves out the packets whose fate in that direction is unknown.
    up, _ = _halved(lost != "true_down", sent, trip, lost, traffic)
    _, down = _halved(lost != "true_up", sent, trip, lost, traffic)
    up, down = _with_unknown((up, down), sent, lost)
    return Measured((up, down), (HALF_NOTE, *notes), {"split": "half"})


def _halved(
    known: np.ndarray,
    sent: np.ndarray,
    trip: np.ndarray,
    lost: np.ndarray,
    traffic: dict[str, Any],
) -> tuple[Way, Way]:
    return halved(sent[known], trip[known], lost[known] != "false", **traffic)


def _with_unknown(ways: tuple[Way, Way], sent: np.ndarray, lost: np.ndarray) -> tuple[Way, Way]:
    """Both directions, each with the times of the packets that were lost in the other direction."""
    up, down = ways
    return (
        replace(up, unknown_ns=sent[lost == "true_down"]),
        replace(down, unknown_ns=sent[lost == "true_up"]),
    )


def _ways(
    rows: list[dict[str, Any]], sent: np.ndarray, how: np.ndarray, traffic: dict[str, Any]
) -> tuple[Way, Way]:
    passed = [k for k, row in enumerate(rows) if row["lost"] == "false"]
    # The file has no time at which a lost packet turned round: take the median of the others.
    usual = int(np.median([rows[k]["send"] for k in passed])) if passed else 0
    up, down = (array("q"), array("q"), array("b")), (array("q"), array("q"), array("b"))
    for row, at in zip(rows, sent.tolist(), strict=True):
        if row["lost"] in ("false", "true", "true_up"):
            _append(up, at, row["send"], row["lost"])
        if row["lost"] == "false":
            # By the server's clock, as `with_one_clock` expects.
            _append(down, at + row["send"], row["receive"], "false")
        elif row["lost"] in ("true", "true_down"):
            _append(down, at + usual, None, row["lost"])
    return _with_unknown((ordered(*up, **traffic), ordered(*down, **traffic)), sent, how)


def _append(way: tuple[array[int], ...], sent: int, delay: int | None, lost: str) -> None:
    way[0].append(sent)
    way[1].append(delay or 0)
    way[2].append(lost != "false")


def _row(path: Path, k: int, trip: Any) -> dict[str, Any]:
    """The fields of a round trip: `lost`, `send`, `receive`, `rtt`, sending times [ns] or None."""
    where = f"round trip {k}"
    lost = str(_at(trip, "lost")).lower()
    if lost not in _LOST:
        raise wrong(path, where, f"lost as one of {', '.join(_LOST)}", _at(trip, "lost"))
    row: dict[str, Any] = {"lost": lost}
    for key in ("send", "receive", "rtt"):
        delay = _at(trip, "delay", key)
        if delay is not None and (not _is_time(delay) or (key == "rtt" and delay < 0)):
            raise wrong(path, where, f"a delay {key} in whole ns", delay)
        row[key] = delay if lost == "false" else None
    if row["send"] is None or row["receive"] is None:
        row["send"] = row["receive"] = None
    for clock in ("monotonic", "wall"):
        time = _at(trip, "timestamps", "client", "send", clock)
        if time is not None and not _is_time(time):
            raise wrong(path, where, "a time of sending in whole ns", time)
        row[clock] = time
    row["seqno"] = _at(trip, "seqno")
    return row


def _need_round_trips(path: Path, rows: list[dict[str, Any]]) -> None:
    for k, row in enumerate(rows):
        if row["lost"] == "false" and row["rtt"] is None:
            raise wrong(path, f"round trip {k}", "a delay rtt in whole ns", None)


def _sending_times(path: Path, rows: list[dict[str, Any]], interval: Any) -> np.ndarray:
    """The sending times [ns] by the client's clock, or else by the numbers and the interval."""
    for clock in ("monotonic", "wall"):
        times = [row[clock] for row in rows]
        if None not in times:
            return np.array(times, dtype=np.int64)
    numbers = [row["seqno"] for row in rows]
    if not _is_time(interval) or not all(isinstance(n, int) and 0 <= n < 2**32 for n in numbers):
        raise ProfileError(
            f"{path}: expected the client's times of sending, or sequence numbers and an interval, "
            "got neither; write the file by irtt client -o FILE.json"
        )
    return np.array([n * min(interval, _MAX_NS >> 32) for n in numbers], dtype=np.int64)


def _at(value: Any, *keys: str) -> Any:
    """The value under nested keys, or None."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _is_time(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < _MAX_NS
