"""Tables of finished trials: a row per trial in a file, and a line per cell in print.

A row has the settings that distinguish its cell, the random settings, the seed, the columns of the
study, and the error that ended the trial, or None.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from experiments.studies.study import value_in_words
from experiments.studies.trial_sequence import Trial
from shared.errors import ConfigError, one_of
from shared.output.text_table import aligned

# Counters by reason. A summary has no entry for a reason that did not occur.
_OPEN_COUNTERS = ("edge_solves.", "link.uplink.refused.", "link.downlink.refused.")
_MAIN_COLUMNS = (
    ("CoM error [cm]", "com_error_m", 100.0),
    ("violation [m/s²]", "contact_violation_m_s2", 1.0),
    ("slip [mm]", "foot_slip_mm.max", 1.0),
    ("held ticks", "commands.held", 1.0),
    ("age p99 [ms]", "projector_age_ms.p99", 1.0),
    ("downlink [kB/s]", "link.downlink.bytes_per_second", 1e-3),
)

_MISSING = object()


def write_trials(rows: Sequence[dict[str, Any]], out: Path) -> None:
    """Write `trials.parquet` into the folder of a sweep."""
    names = list(rows[0]) if rows else []
    table = pa.table({name: [row[name] for row in rows] for name in names})
    pq.write_table(table, out / "trials.parquet")


def read_trials(out: Path) -> pa.Table:
    """Read the table in the folder of a sweep, a row per trial; `ConfigError` without a table."""
    path = out / "trials.parquet"
    if not path.is_file():
        raise ConfigError(f"expected the folder of a finished sweep, got {out}: no {path.name}")
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise ConfigError(f"cannot read {path}: {' '.join(str(error).split())}") from None
    if not table.num_rows or not {"seed", "fell", "error"} <= set(table.column_names):
        raise ConfigError(f"expected rows with seed, fell and error, got others in {path}")
    return table


def row_of(trial: Trial, record: dict[str, Any], columns: Sequence[str]) -> dict[str, Any]:
    """A trial's row, from the summary and the error of its record.

    Raise ConfigError for a column that is not in the summary.
    """
    values = {name: _field(record["summary"], name) for name in columns}
    return {**trial.label, **values, **trial.label, "error": record["error"]}


def wilson_interval(successes: int, trials: int, *, z: float = 1.959964) -> tuple[float, float]:
    """Wilson score interval of a proportion, 95 % for the z given.

    (p + z²/2n ± z √(p (1 − p)/n + z²/4n²)) / (1 + z²/n) with p = successes/n; (0, 1) for no trials.
    """
    if trials == 0:
        return 0.0, 1.0
    p, n = successes / trials, trials
    centre, scale = p + z * z / (2 * n), 1 + z * z / n
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (centre - half) / scale), min(1.0, (centre + half) / scale)


def table_in_words(rows: Sequence[dict[str, Any]], settings: Sequence[str]) -> str:
    """A table with a line per cell. Means are over the trials that finished standing."""
    cells: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault(tuple(value_in_words(row[name]) for name in settings), []).append(row)
    main = [shown for shown in _MAIN_COLUMNS if rows and shown[1] in rows[0]]
    lines = [[*settings, "stood", "95 %", *(heading for heading, _, _ in main)]]
    for named, trials in cells.items():
        played = [row for row in trials if row["error"] is None]
        standing = [row for row in played if not row["fell"]]
        low, high = wilson_interval(len(standing), len(played))
        stood = [f"{len(standing)}/{len(played)}", f"{100 * low:.0f}–{100 * high:.0f} %"]
        means = []
        for _, column, scale in main:
            values = [scale * row[column] for row in standing if row[column] is not None]
            means.append(_number(sum(values) / len(values)) if values else "-")
        lines.append([*named, *stood, *means])
    return "\n".join([*aligned(lines), *errors_in_words(rows)])


def errors_in_words(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A line on the trials that are not counted, by error or as no result; [] without any."""
    errors = [row["error"] for row in rows if row["error"] is not None]
    return [f"trials without a result: {len(errors)}; the first: {errors[0]}"] if errors else []


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _field(summary: dict[str, Any] | None, name: str) -> Any:
    if summary is None:
        return None
    value: Any = summary
    for key in name.split("."):
        value = value.get(key, _MISSING) if isinstance(value, dict) else _MISSING
    if value is not _MISSING and not isinstance(value, dict):
        return value
    if name.startswith(_OPEN_COUNTERS):
        return 0
    if summary["network"] == "direct":  # its summary has no report of the link
        return None
    raise ConfigError(f"columns: {one_of(_fields(summary), name)}")


def _fields(summary: dict[str, Any]) -> Iterator[str]:
    for key, value in summary.items():
        if isinstance(value, dict):
            yield from (f"{key}.{name}" for name in _fields(value))
        else:
            yield key
