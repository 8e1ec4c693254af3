"""A recording of a finished run, from the tables in its folder.

    config.toml         the run's configuration, which names the robot
    telemetry.parquet   the robot's rows
    link.parquet        the link's rows, if there
    edge.parquet        the edge's rows, if there

The result is `recording.rrd`, opened by `rerun recording.rrd`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

import numpy as np
import pyarrow as pa
import rerun as rr

from shared.config_file import load_config
from shared.errors import UserError
from shared.robots import load_robot
from shared.telemetry import Schema, read_parquet, row_chunks
from viewer.blueprint import layout
from viewer.meshes import load_meshes
from viewer.scene import Scene

APPLICATION = "remote-wbc"


@dataclass(frozen=True)
class Recorded:
    """What `record` wrote: the file, its rows of all kinds and its size [bytes]."""

    path: Path
    rows: int
    size_bytes: int


def new_recording(name: str) -> rr.RecordingStream:
    """A recording stream under the project's name, buffered until it gets a sink."""
    recording = rr.RecordingStream(APPLICATION, recording_id=uuid4())
    recording.send_recording_name(name)
    return recording


def record(run: Path) -> Recorded:
    """Build `run`/recording.rrd; `UserError` if the folder is not that of a run."""
    if not run.is_dir():
        raise UserError(f"record: expected the folder of a run, got {run}")
    robot = load_robot(load_config(run / "config.toml").robot.name)
    tables = [_read(run / "telemetry.parquet")]
    if "q" not in tables[0][0].slices:
        raise UserError(f"record: expected rows of the robot in {run / 'telemetry.parquet'}")
    tables += [_read(run / n) for n in ("link.parquet", "edge.parquet") if (run / n).exists()]
    path, partial = run / "recording.rrd", run / "recording.rrd.partial"
    recording = new_recording(run.resolve().name)
    try:
        recording.save(partial, default_blueprint=layout(live=False))
        scene = Scene(recording, robot, load_meshes(robot))
        for schema, rows in tables:
            for chunk in row_chunks(rows):
                scene.log_rows(schema, chunk)
        recording.disconnect()
        partial.replace(path)
    except OSError as error:
        raise UserError(f"record: cannot write {path}: {error.strerror or error}") from None
    finally:
        recording.disconnect()
        partial.unlink(missing_ok=True)
    return Recorded(path, sum(len(rows) for _, rows in tables), path.stat().st_size)


def _read(path: Path) -> tuple[Schema, np.ndarray]:
    try:
        return read_parquet(path)
    except FileNotFoundError:
        raise UserError(f"record: expected a table of telemetry at {path}, found none") from None
    except (OSError, pa.ArrowException, ValueError) as error:
        raise UserError(f"record: cannot read {path}: {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
