"""Delay profiles: the one-way delay, each way, of a message sent at each instant.

A profile is replayed by time: a message sent t after the start takes the delay that the profile
holds for t, and the profile repeats when it ends. `constant:30ms` is a profile too: its duration is
the *round trip*, as in the paper's Tables II and III, half each way; `constant:10ms/20ms` gives
uplink and downlink apart.
"""

from __future__ import annotations

import csv
import io
import json
import tokenize
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shared.errors import ConfigError, ProfileError
from shared.quantities import parse_duration_ns

SHIPPED = Path(__file__).parent / "profiles"
LOST = -1
# No link of use is slower; a larger number is an error of units.
MAX_DELAY_MS = 3_600_000.0
UPLINK, DOWNLINK = 0, 1
DIRECTIONS = ("uplink", "downlink")


@dataclass(frozen=True)
class DelayProfile:
    """One-way delays [ns], one per `period_ns` of sending time, each way; `LOST` for a loss.

    `delays_ns` (2, n) int64, uplink then downlink.
    """

    name: str
    delays_ns: np.ndarray
    period_ns: int = 1_000_000
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def duration_ns(self) -> int:
        """Length of one pass [ns]."""
        return self.delays_ns.shape[1] * self.period_ns

    def delay_ns(self, direction: int, elapsed_ns: int) -> int:
        """Delay of a message sent `elapsed_ns` after the profile began, or `LOST`."""
        index = (elapsed_ns // self.period_ns) % self.delays_ns.shape[1]
        return int(self.delays_ns[direction, index])

    def start_offset_ns(self, seed: int) -> int:
        """Where in the profile a run of this seed begins: a whole number of periods."""
        n = self.delays_ns.shape[1]
        return int(np.random.default_rng([seed, 7]).integers(n)) * self.period_ns

    @property
    def nominal_round_trip_ns(self) -> int:
        """Median uplink plus median downlink delay [ns], losses aside."""
        return int(sum(np.median(way[way != LOST]) for way in self.delays_ns))


def load_profile(network: str) -> DelayProfile:
    """A profile by shipped name (`factory/001`), file (.npz or .csv) or `constant:…`."""
    if network.startswith("constant:"):
        return constant_profile(network)
    shipped, path = SHIPPED / f"{network}.npz", Path(network)
    if _is_file(shipped):
        return _read_npz(shipped, name=network)
    if _is_file(path):
        if path.suffix == ".npz":
            return _read_npz(path, name=path.stem)
        if path.suffix == ".csv":
            return _read_csv(path)
        raise ProfileError(f"profile: expected a .npz or .csv file, got {path}")
    examples = ", ".join(sorted({name.split("/")[0] + "/001" for name in shipped_names()}))
    raise ProfileError(
        f"network: expected a shipped profile ({examples}, …), a .npz or .csv file, constant:30ms "
        f"or direct, got {network!r}: no such profile or file"
    )


def shipped_names() -> list[str]:
    """Names of the profiles that come with the project."""
    return sorted(
        p.relative_to(SHIPPED).with_suffix("").as_posix() for p in SHIPPED.glob("*/*.npz")
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name no file can have
        return False


def constant_profile(network: str) -> DelayProfile:
    """`constant:ROUND_TRIP` or `constant:UP/DOWN`."""
    _, _, text = network.partition(":")
    try:
        parts = [parse_duration_ns(part) for part in text.split("/")]
    except ConfigError as error:
        raise ProfileError(f"network {network!r}: {error}") from None
    if len(parts) == 1:
        parts = [parts[0] // 2, parts[0] - parts[0] // 2]
    if len(parts) != 2:
        raise ProfileError(f"network {network!r}: expected constant:30ms or constant:10ms/20ms")
    return DelayProfile(name=network, delays_ns=np.array(parts, dtype=np.int64).reshape(2, 1))


def _read_npz(path: Path, *, name: str) -> DelayProfile:
    try:
        # Opened here: numpy leaves a file open that it cannot read.
        with path.open("rb") as file, np.load(io.BytesIO(file.read())) as arrays:
            ways = [np.asarray(arrays[f"{way}_us"]) for way in DIRECTIONS]
            metadata = json.loads(str(arrays["meta"])) if "meta" in arrays else {}
    except (
        *(OSError, KeyError, ValueError, TypeError, AttributeError, EOFError),
        NotImplementedError,
        *(RuntimeError, zipfile.BadZipFile, zlib.error, tokenize.TokenError),
    ) as error:
        raise ProfileError(
            f"profile {path}: expected arrays uplink_us and downlink_us: {error}"
        ) from None
    for name_us, way in zip(DIRECTIONS, ways, strict=True):
        if way.dtype.kind not in "iuf" or not np.isfinite(way).all():
            raise ProfileError(
                f"profile {path}: expected whole numbers of µs in {name_us}_us, got {way.dtype} "
                "with values that are none"
            )
    if any(way.ndim != 1 for way in ways) or len(ways[0]) != len(ways[1]) or not len(ways[0]):
        raise ProfileError(
            f"profile {path}: expected uplink_us and downlink_us of one equal length, got shapes "
            f"{ways[0].shape} and {ways[1].shape}"
        )
    delays_us = np.vstack(ways)
    wrong = (delays_us < LOST) | (delays_us > MAX_DELAY_MS * 1000)
    if np.any(wrong):
        way, index = np.argwhere(wrong)[0]
        raise ProfileError(
            f"profile {path}: {DIRECTIONS[way]}_us[{index}] = {delays_us[way, index]}: expected a "
            f"delay from 0 to {MAX_DELAY_MS * 1000:.0f} µs, or -1 for a lost message"
        )
    delays_us = delays_us.astype(np.int64)
    return _checked(name, np.where(delays_us == LOST, LOST, delays_us * 1000), metadata)


def _read_csv(path: Path) -> DelayProfile:
    """`uplink_ms,downlink_ms` with one row per millisecond; `lost` for a lost message."""
    rows: list[tuple[int, int]] = []
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        try:
            header = [cell.strip() for cell in next(reader, [])]
            if header != ["uplink_ms", "downlink_ms"]:
                raise ProfileError(
                    f"profile {path}, line 1: expected the header uplink_ms,downlink_ms, got "
                    f"{','.join(header)!r}"
                )
            for cells in reader:
                if cells:
                    rows.append(_csv_row(path, reader.line_num, cells))
        except (UnicodeDecodeError, csv.Error) as error:
            raise ProfileError(
                f"profile {path}, line {reader.line_num}: not a text file of values: {error}"
            ) from None
    if not rows:
        raise ProfileError(f"profile {path}: expected at least one row after the header")
    return _checked(path.stem, np.array(rows, dtype=np.int64).T, {"source": path.name})


def _csv_row(path: Path, line: int, cells: list[str]) -> tuple[int, int]:
    try:
        up, down = (LOST if cell.strip() == "lost" else round(float(cell) * 1e6) for cell in cells)
        if max(up, down) > MAX_DELAY_MS * 1e6 or "-" in "".join(cells):
            raise ValueError
    except (ValueError, OverflowError):
        raise ProfileError(
            f"profile {path}, line {line}: expected two delays in ms (or lost) as in 1.7,1.9, got "
            f"{','.join(cells)!r}"
        ) from None
    return up, down


def _checked(name: str, delays_ns: np.ndarray, metadata: dict[str, Any]) -> DelayProfile:
    for way, delays in zip(DIRECTIONS, delays_ns, strict=True):
        if np.all(delays == LOST):
            raise ProfileError(f"profile {name}: every {way} message is lost")
    return DelayProfile(name=name, delays_ns=delays_ns, metadata=metadata)
