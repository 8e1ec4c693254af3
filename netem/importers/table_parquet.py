"""Tables in parquet, whose columns may be times with the file's unit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from netem.importers.columns import (
    LOST_NS,
    Place,
    Read,
    found_in,
    is_lost,
    place_of,
    sequence_number,
    value_ns,
)
from netem.importers.measured import UNITS_NS
from netem.importers.options import Options
from netem.importers.source import MAX_NS, MAX_RECORDS, wrong
from shared.errors import ConfigError, ProfileError

PARQUET = b"PAR1"


def read_parquet(path: Path, columns: Mapping[str, str], options: Options) -> Read:
    names = parquet_names(path)
    values: dict[str, np.ndarray] = {}
    units: dict[str, int | None] = {}
    ids: list[str] = []
    notes: tuple[str, ...] = ()
    for key, name in columns.items():
        if not found_in(name, names):
            raise wrong(path, "schema", f"a column {name}", ", ".join(names))
        place = place_of(path, "schema", name, names, options.unit, names)
        if key == "id":
            ids = [str(each) for each in _column(path, names[place.at[0]]).to_pylist()]
            continue
        if key == "seq":
            cells = _column(path, names[place.at[0]]).to_pylist()
            values[key] = np.array(
                [sequence_number(str(c), path, f"row {k + 1}") for k, c in enumerate(cells)],
                dtype=np.int64,
            )
            continue
        parts = [
            _parquet_times(path, names[at], unit, key, options)
            for at, unit in zip(place.at, place.units_ns, strict=True)
        ]
        lost = np.any([part == LOST_NS for part in parts], axis=0)
        if key in ("sent", "time") and lost.any():
            raise wrong(path, f"column {name}", "finite times, none of sending missing", "others")
        values[key] = np.where(lost, LOST_NS, np.sum(parts, axis=0))
        units[key] = place.units_ns[0]
    rows = [f"row {k + 1}" for k in range(len(next(iter(values.values()), ids)))]
    return Read(values, rows, units, ids, notes)


def _parquet_times(
    path: Path, name: str, unit: int | None, key: str, options: Options
) -> np.ndarray:
    """A column as ns, `LOST_NS` if a value is missing or marks a lost packet."""
    import pyarrow as pa

    column = _column(path, name)
    kind = column.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_dictionary(kind):
        place = Place((0,), (unit,))
        return np.array(
            [
                value_ns([str(cell or "").strip()], place, key, ",", options, path, f"row {k + 1}")
                for k, cell in enumerate(column.to_pylist())
            ],
            dtype=np.int64,
        )
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_time(kind):
        unit = UNITS_NS[kind.unit]
        column = column.cast(pa.int32() if pa.types.is_time32(kind) else pa.int64())
    elif not pa.types.is_integer(kind) and not pa.types.is_floating(kind):
        raise wrong(path, f"column {name}", "numbers or times", str(kind))
    if unit is None:
        raise ConfigError(
            f"{path}: column {name}: expected its unit in its name, as in {name}(ms), or --unit as "
            "one of s, ms, us, ns; got none"
        )
    cells = column.fill_null(0).to_numpy()
    lost = column.is_null().to_numpy(zero_copy_only=False) | np.isnan(cells)
    if key not in ("sent", "time"):
        lost |= np.isposinf(cells)
        if options.lost:
            lost |= np.array([is_lost(str(cell), options) for cell in cells.tolist()], dtype=bool)
    cells = np.where(lost, 0, cells)
    whole = cells.dtype.kind in "iu"
    ends = (
        [(int if whole else float)(end) for end in (cells.min(), cells.max())] if len(cells) else []
    )
    if not all(abs(end * unit) < MAX_NS for end in ends):
        raise wrong(path, f"column {name}", "finite times, none of sending missing", "others")
    times = cells.astype(np.int64) * unit if whole else np.rint(cells * unit)
    return np.where(lost, LOST_NS, times.astype(np.int64))


def _column(path: Path, name: str) -> Any:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        return parquet.read_table(path, columns=[name]).column(0)
    except (pa.ArrowException, OSError, KeyError, IndexError) as error:
        raise ProfileError(f"{path}: cannot read column {name}: {_one_line(error)}") from None


def parquet_names(path: Path) -> list[str]:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            if file.metadata.num_rows > MAX_RECORDS:
                raise ProfileError(
                    f"{path}: expected at most {MAX_RECORDS} rows, got {file.metadata.num_rows}; "
                    "cut it"
                )
            return [file.schema.column(k).path for k in range(len(file.schema))]
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ProfileError(f"{path}: expected a parquet file, got: {_one_line(error)}") from None


def first_cells(path: Path) -> list[str]:
    """Return the first row as text; a time of its column's type is a date and time."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            first = next(file.iter_batches(batch_size=1), None)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ProfileError(f"{path}: cannot read its first row: {_one_line(error)}") from None
    return [] if first is None else [str(column[0]) for column in first.columns]


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]
