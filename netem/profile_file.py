"""Profiles as files, `.npz` and `.csv`; `docs/profiles.md` describes both.

An invalid file is refused. The error names the array or line that is wrong.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from netem.profile import DIRECTIONS, LOST, MAX_DELAY_MS, PERIOD_NS, DelayProfile
from shared.commands import wbc
from shared.errors import ProfileError
from shared.npz_file import read_npz
from shared.regular_file import open_regular

CSV_HEADER = ("uplink_ms", "downlink_ms")
# Five and a half hours in periods of 1 ms.
_MAX_PERIODS = 20_000_000
_MAX_ARRAY_BYTES = 8 * _MAX_PERIODS + 1024
_MAX_BYTES = 500_000_000


def is_file(path: Path) -> bool:
    """Return whether there is such a file; False for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_profile(path: Path, *, name: str | None = None) -> DelayProfile:
    """The profile in a file. `ProfileError` names the array or line that is wrong."""
    read = {".npz": _read_npz, ".csv": _read_csv}.get(path.suffix)
    if read is None:
        raise ProfileError(
            f"profile: expected a .npz or .csv file, got {path}; try "
            f"{wbc('netem convert')} for other formats"
        )
    try:
        return read(path, name or path.stem)
    except OSError as error:
        raise ProfileError(f"profile {path}: cannot read it: {error.strerror}") from None


def write_profile(profile: DelayProfile, path: Path) -> None:
    """Write `path` (.npz or .csv), whole or not at all. `ProfileError` if it cannot be written."""
    write = {".npz": _write_npz, ".csv": _write_csv}.get(path.suffix)
    if write is None:
        raise ProfileError(f"profile: expected a name that ends in .npz or .csv, got {path}")
    unfinished = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(profile, unfinished)
        os.replace(unfinished, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise ProfileError(f"profile {path}: cannot write it: {error.strerror}") from None


def _read_npz(path: Path, name: str) -> DelayProfile:
    try:
        arrays = read_npz(path, at_most=_MAX_BYTES, array_at_most=_MAX_ARRAY_BYTES)
        ways = [arrays.pop(f"{way}_us") for way in DIRECTIONS]
        metadata = json.loads(str(arrays.pop("meta"))) if "meta" in arrays else {}
    except (KeyError, ValueError, RecursionError) as error:
        raise ProfileError(
            f"profile {path}: expected arrays uplink_us and downlink_us, got: {error}"
        ) from None
    for direction, way in zip(DIRECTIONS, ways, strict=True):
        if way.dtype.kind not in "iuf" or not np.isfinite(way).all():
            raise ProfileError(
                f"profile {path}: expected whole numbers of µs in {direction}_us, got {way.dtype} "
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
            f"profile {path}: {DIRECTIONS[way]}_us[{index}]: expected a delay from 0 to "
            f"{MAX_DELAY_MS * 1000:.0f} µs, or -1 for a lost message, got {delays_us[way, index]}"
        )
    delays_us = delays_us.astype(np.int64)
    delays_ns = np.where(delays_us == LOST, LOST, delays_us * 1000)
    return _checked(path, name, delays_ns, metadata, arrays)


def _write_npz(profile: DelayProfile, path: Path) -> None:
    delays_us = np.where(profile.delays_ns == LOST, LOST, np.rint(profile.delays_ns / 1000))
    arrays: dict[str, Any] = {
        f"{way}_us": delays.astype(np.int64)
        for way, delays in zip(DIRECTIONS, delays_us, strict=True)
    }
    arrays |= {**profile.columns, "meta": np.array(json.dumps(_with_period(profile)))}
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _read_csv(path: Path, name: str) -> DelayProfile:
    """`uplink_ms,downlink_ms` and further columns, after `# key: value` lines of metadata."""
    metadata: dict[str, Any] = {}
    rows: list[tuple[int, int]] = []
    further: list[list[float]] = []
    header: list[str] = []
    with io.TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        try:
            for cells in reader:
                if not header and cells and cells[0].startswith("#"):
                    key, _, value = ",".join(cells)[1:].partition(":")
                    metadata[key.strip()] = _json_or_text(value.strip())
                elif not header:
                    header = _csv_header(path, reader.line_num, cells)
                elif cells:
                    if len(rows) == _MAX_PERIODS:
                        raise ProfileError(
                            f"profile {path}: expected at most {_MAX_PERIODS} periods, got more"
                        )
                    if len(cells) != len(header):
                        raise ProfileError(
                            f"profile {path}, line {reader.line_num}: expected {len(header)} "
                            f"values, got {','.join(cells)!r}"
                        )
                    rows.append(_csv_delays(path, reader.line_num, cells[:2]))
                    further.append(_csv_numbers(path, reader.line_num, cells[2:]))
        except (UnicodeDecodeError, csv.Error) as error:
            raise ProfileError(
                f"profile {path}, line {reader.line_num}: expected text, got: {error}"
            ) from None
    if not rows:
        raise ProfileError(
            f"profile {path}: expected the header {','.join(CSV_HEADER)} and at least one row, got "
            f"{'no row' if header else 'neither'}"
        )
    columns = dict(zip(header[2:], np.array(further).T, strict=True)) if header[2:] else {}
    metadata.setdefault("source", path.name)
    return _checked(path, name, np.array(rows, dtype=np.int64).T, metadata, columns)


def _write_csv(profile: DelayProfile, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        for key, value in _with_period(profile).items():
            file.write(f"# {key}: {json.dumps(value)}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*CSV_HEADER, *profile.columns])
        writer.writerows(_csv_rows(profile))


def _csv_rows(profile: DelayProfile) -> Iterator[list[str]]:
    for delays, *further in zip(profile.delays_ns.T, *profile.columns.values(), strict=True):
        ways = ["lost" if delay == LOST else f"{delay * 1e-6:.6f}" for delay in delays]
        yield [*ways, *(f"{value:.10g}" for value in further)]


def _csv_header(path: Path, line: int, cells: list[str]) -> list[str]:
    header = [cell.strip() for cell in cells]
    if tuple(header[:2]) != CSV_HEADER:
        raise ProfileError(
            f"profile {path}, line {line}: expected the header {','.join(CSV_HEADER)}, got "
            f"{','.join(header)!r}"
        )
    return header


def _csv_delays(path: Path, line: int, cells: list[str]) -> tuple[int, int]:
    try:
        up, down = (LOST if cell.strip() == "lost" else round(float(cell) * 1e6) for cell in cells)
        if max(up, down) > MAX_DELAY_MS * 1e6 or "-" in "".join(cells).replace("e-", ""):
            raise ValueError
    except (ValueError, OverflowError):
        raise ProfileError(
            f"profile {path}, line {line}: expected two delays in ms (or lost) as in 1.7,1.9, got "
            f"{','.join(cells)!r}"
        ) from None
    return up, down


def _csv_numbers(path: Path, line: int, cells: list[str]) -> list[float]:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        raise ProfileError(
            f"profile {path}, line {line}: expected numbers in the further columns, got "
            f"{','.join(cells)!r}"
        ) from None


def _json_or_text(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _with_period(profile: DelayProfile) -> dict[str, Any]:
    return {**profile.metadata, "period_us": profile.period_ns / 1000}


def _checked(
    path: Path,
    name: str,
    delays_ns: np.ndarray,
    metadata: Any,
    columns: Mapping[str, np.ndarray],
) -> DelayProfile:
    for way, delays in zip(DIRECTIONS, delays_ns, strict=True):
        if np.all(delays == LOST):
            raise ProfileError(
                f"profile {path}: expected {way} messages that arrive, got only lost ones"
            )
    if not isinstance(metadata, dict):
        raise ProfileError(f"profile {path}: expected meta to be a JSON object, got {metadata!r}")
    period_us = metadata.get("period_us", PERIOD_NS / 1000)
    if not isinstance(period_us, int | float) or not 1 <= period_us <= 1e6:
        raise ProfileError(
            f"profile {path}: period_us: expected from 1 to 1000000 µs, got {period_us!r}"
        )
    for key, values in columns.items():
        if values.shape != delays_ns[0].shape or values.dtype.kind not in "iufb":
            raise ProfileError(
                f"profile {path}: {key}: expected {delays_ns.shape[1]} numbers, one per period, "
                f"got {values.dtype} of shape {values.shape}"
            )
        if key.endswith("_capacity_bytes") and not (np.nan_to_num(values, nan=-1.0) >= 0).all():
            raise ProfileError(
                f"profile {path}: {key}: expected numbers of bytes of 0 or more, got others"
            )
    return DelayProfile(name, delays_ns, round(period_us * 1000), metadata, columns)
