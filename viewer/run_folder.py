"""Read the folder of a run: its configuration and its tables.

    config.toml         the run's configuration, which names the robot
    telemetry.parquet   the robot's rows
    link.parquet        the link's rows, if there
    edge.parquet        the edge's rows, if there
    steps.parquet       the robot's footprints, if there

The rows of a service that was killed, NAME.rows, become such a table first.

Lockstep and live runs have the same files. An hour of the robot's rows does not fit into memory, so
rows are read in chunks.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.errors import UserError
from shared.robots import load_robot
from shared.telemetry.lives import recover
from shared.telemetry.parquet import parquet_chunks, parquet_shape, read_parquet
from shared.telemetry.schema import Schema, tick_schema

_FILES = ("config.toml", "telemetry.parquet")
_OTHERS = ("link.parquet", "edge.parquet", "steps.parquet")


@dataclass(frozen=True)
class RunFolder:
    """A run: its settings, and its `tables` of telemetry, the robot's first.

    `rows` is the number of rows in all tables. `duration` is the length of the task [s], zero if it
    never began.
    """

    path: Path
    config: RunConfig
    tables: tuple[Path, ...]
    rows: int
    duration: float

    @property
    def name(self) -> str:
        return self.path.resolve().name

    def chunks(self) -> Iterator[tuple[Schema, np.ndarray]]:
        """Yield the rows, table after table; raise `UserError` if they cannot be read."""
        for table in self.tables:
            with _reading(table):
                yield from parquet_chunks(table)


def read_run(path: Path) -> RunFolder:
    """Read a run; raise `UserError` if this is no run's folder, or one of another version."""
    if not path.is_dir():
        raise UserError(
            f"expected the folder of a run, as in runs/…, or as `wbc trial --out "
            f"DIR` writes it, got {path}"
        )
    for stem in ("telemetry", "link", "edge", "steps"):
        with _reading(path / f"{stem}.rows"):
            recover(path, stem)
    missing = [name for name in _FILES if not (path / name).is_file()]
    if missing:
        raise UserError(
            f"{path}: expected the folder of a run, with {' and '.join(_FILES)}, got one "
            f"without {' and '.join(missing)}"
        )
    config = load_config(path / "config.toml")
    ticks = path / "telemetry.parquet"
    tables = (ticks, *(path / name for name in _OTHERS if (path / name).exists()))
    shapes = []
    for table in tables:
        with _reading(table):
            shapes.append(parquet_shape(table))
    schema, _ = shapes[0]
    model = load_robot(config.robot.name).model
    expected = tick_schema(nq=model.nq, nv=model.nv)
    if schema.slices != expected.slices:
        raise UserError(
            f"{ticks}: expected the rows of a {config.robot.label} as this version records them, "
            f"{_difference(expected, schema)}; play the run again"
        )
    with _reading(ticks):
        _, times_ns = read_parquet(ticks, columns=("time_ns",))
    duration = 1e-9 * max(0.0, float(times_ns.max(initial=0.0)))
    return RunFolder(path, config, tables, sum(count for _, count in shapes), duration)


def _difference(expected: Schema, found: Schema) -> str:
    missing = [name for name in expected.slices if name not in found.slices]
    if missing:
        return f"found no {', '.join(missing)}"
    return "found columns of other widths or another order"


@contextmanager
def _reading(table: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, pa.ArrowException, ValueError) as error:
        lines = str(error).splitlines() or [type(error).__name__]
        raise UserError(f"cannot read {table}: {lines[0]}") from None
