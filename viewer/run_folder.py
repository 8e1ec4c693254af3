"""The folder of a run, read: its configuration and the tables that there are.

    config.toml         the run's configuration, which names the robot
    telemetry.parquet   the robot's rows
    link.parquet        the link's rows, if there
    edge.parquet        the edge's rows, if there

A run that was played in lockstep and one that was live have the same ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from shared.config import RunConfig
from shared.config_file import load_config
from shared.errors import UserError
from shared.robots import load_robot
from shared.telemetry import Schema, read_parquet, tick_schema

_FILES = ("config.toml", "telemetry.parquet")


@dataclass(frozen=True)
class RunFolder:
    """A run: `tables` of telemetry, the robot's first."""

    path: Path
    config: RunConfig
    tables: tuple[tuple[Schema, np.ndarray], ...]

    @property
    def name(self) -> str:
        return self.path.resolve().name

    @property
    def rows(self) -> int:
        """How many there are in all tables."""
        return sum(len(rows) for _, rows in self.tables)

    @property
    def duration(self) -> float:
        """Until the last tick of the task [s]; zero if it never began."""
        schema, rows = self.tables[0]
        return max(0.0, float(schema.column(rows, "time_ns").max(initial=0.0))) * 1e-9


def read_run(path: Path) -> RunFolder:
    """`UserError` in one line if this is not the folder of a run, or of another version's."""
    if not path.is_dir():
        raise UserError(
            f"expected the folder of a run, as in runs/…, or as `python -m experiments trial --out "
            f"DIR` writes it, got {path}"
        )
    missing = [name for name in _FILES if not (path / name).is_file()]
    if missing:
        raise UserError(
            f"{path}: expected the folder of a run, with {' and '.join(_FILES)}; found no "
            f"{' and no '.join(missing)}"
        )
    config = load_config(path / "config.toml")
    schema, rows = _read(path / "telemetry.parquet")
    model = load_robot(config.robot.name).model
    expected = tick_schema(nq=model.nq, nv=model.nv)
    if schema.slices != expected.slices:
        raise UserError(
            f"{path / 'telemetry.parquet'}: expected the rows of a {config.robot.name} as this "
            f"version records them, {_difference(expected, schema)}; play the run again"
        )
    others = [
        _read(path / name) for name in ("link.parquet", "edge.parquet") if (path / name).exists()
    ]
    return RunFolder(path, config, ((schema, rows), *others))


def _difference(expected: Schema, found: Schema) -> str:
    missing = [name for name in expected.slices if name not in found.slices]
    if missing:
        return f"found no {', '.join(missing)}"
    return "found columns of other widths or another order"


def _read(path: Path) -> tuple[Schema, np.ndarray]:
    try:
        return read_parquet(path)
    except (OSError, pa.ArrowException, ValueError) as error:
        lines = str(error).splitlines() or [type(error).__name__]
        raise UserError(f"cannot read {path}: {lines[0]}") from None
