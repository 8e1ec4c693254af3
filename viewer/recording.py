"""Recordings of finished runs: one alone, or several side by side.

`record` writes `recording.rrd` into a run's folder. `rerun recording.rrd` opens it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

import rerun as rr
import rerun.blueprint as rrb

from shared.errors import UserError
from shared.robots import load_robot
from shared.telemetry.outages import OUTAGE_NS
from viewer.blueprint import Picture, compared_layout, layout
from viewer.colours import RUNS
from viewer.meshes import load_meshes
from viewer.run_folder import RunFolder, read_run
from viewer.scene import Scene
from viewer.title import compared_names, compared_title, log_title, title
from viewer.track import SIDE_BY_SIDE, Track

APPLICATION = "remote-wbc"


@dataclass(frozen=True)
class Recorded:
    """The result of `record`: the file, its number of rows of all kinds, its size [bytes]."""

    path: Path
    rows: int
    size_bytes: int


def new_recording(name: str) -> rr.RecordingStream:
    """Return a recording stream under the project's name, buffered until it gets a sink."""
    recording = rr.RecordingStream(APPLICATION, recording_id=uuid4())
    recording.send_recording_name(name)
    return recording


def record(path: Path) -> Recorded:
    """Build `path`/recording.rrd; raise `UserError` if `path` is not the folder of a run."""
    run = read_run(path)
    file = path / "recording.rrd"
    save([run], file)
    return Recorded(file, run.rows, file.stat().st_size)


def save(runs: Sequence[RunFolder], file: Path, *, picture: Picture | None = None) -> None:
    """Write a recording of `runs`; raise `UserError` and leave no file if that fails."""
    partial = file.with_name(f"{file.name}.partial")
    recording = new_recording(" and ".join(run_names(runs)))
    try:
        recording.save(partial, default_blueprint=blueprint(runs, picture=picture))
        log_runs(recording, runs)
        recording.disconnect()
        partial.replace(file)
    except OSError as error:
        raise UserError(f"cannot write {file}: {error.strerror or error}") from None
    finally:
        recording.disconnect()
        partial.unlink(missing_ok=True)


def run_names(runs: Sequence[RunFolder]) -> list[str]:
    """Return the name of the run, or names of several by what differs between them."""
    if len(runs) == 1:
        return [runs[0].name]
    return compared_names([run.config for run in runs], [run.path for run in runs])


def blueprint(runs: Sequence[RunFolder], *, picture: Picture | None = None) -> rrb.Blueprint:
    """Return the layout for one run, or for several."""
    duration = max(run.duration for run in runs)
    if len(runs) == 1:
        return layout(runs[0].config, duration=duration, picture=picture)
    return compared_layout([run.config for run in runs], duration=duration, picture=picture)


def log_runs(recording: rr.RecordingStream, runs: Sequence[RunFolder]) -> None:
    """Draw all runs, side by side from right to left."""
    names = run_names(runs)
    tracks = [Track()] if len(runs) == 1 else _tracks(runs, names)
    verdicts = []
    for run, track in zip(runs, tracks, strict=True):
        robot = load_robot(run.config.robot.name)
        scene = Scene(recording, robot, run.config, meshes=load_meshes(robot), track=track)
        for schema, rows in run.chunks():
            scene.log_rows(schema, rows)
        scene.look_for_silence(patience_ns=OUTAGE_NS)
        scene.finish()
        verdicts.append(scene.verdict)
        if not track.alone:
            _log_sign(recording, track, scene.verdict)
    configs = [run.config for run in runs]
    alone = len(runs) == 1
    log_title(
        recording,
        title(configs[0], verdicts[0]) if alone else compared_title(configs, names, verdicts),
    )


def _tracks(runs: Sequence[RunFolder], names: Sequence[str]) -> list[Track]:
    """Return tracks side by side in the given order."""
    if len(runs) > len(RUNS):
        raise UserError(f"expected at most {len(RUNS)} runs to compare, got {len(runs)}")
    if len(set(names)) < len(names):
        raise UserError(f"expected different runs to compare, got {', '.join(names)}")
    middle = (len(runs) - 1) / 2
    return [
        Track(name, RUNS[k], (0.0, (k - middle) * SIDE_BY_SIDE, 0.0))
        for k, name in enumerate(names)
    ]


def _log_sign(recording: rr.RecordingStream, track: Track, verdict: str) -> None:
    """Draw the run's name and outcome on the floor before its robot."""
    sign = rr.Points3D(
        [(0.45, 0.0, 0.0)],
        labels=[f"{track.name} {verdict}"],
        colors=None if track.colour is None else [track.colour],
        radii=[0.01],
        show_labels=True,
    )
    recording.log(track.world("sign"), sign, static=True)
