"""Columns of values with their instants, sent to the entities of one run."""

from __future__ import annotations

import numpy as np
import rerun as rr

from viewer.plots import peak_rows
from viewer.task_time import Instants
from viewer.track import Track

TIMELINE = "task_time"
WALL_TIMELINE = "wall_time"


class Recorder:
    """The recording of a run, or of several, as the entities of one of them."""

    def __init__(self, recording: rr.RecordingStream, track: Track) -> None:
        self.recording = recording
        self.track = track
        self._states: dict[str, int] = {}

    def send(self, path: str, instants: Instants, columns: rr.ComponentColumnList) -> None:
        """One row of `columns` per instant."""
        self.recording.send_columns(
            path,
            [
                rr.TimeColumn(TIMELINE, duration=instants.task_ns.astype("timedelta64[ns]")),
                rr.TimeColumn(WALL_TIMELINE, duration=instants.wall_ns.astype("timedelta64[ns]")),
            ],
            columns,
        )

    def peaks(self, path: str, instants: Instants, values: np.ndarray) -> None:
        """Lines (n, k) of a plot, thinned to what can be seen."""
        kept = peak_rows(instants.task_ns, values)
        if len(kept):
            self.lines(path, instants[kept], values[kept])

    def lines(self, path: str, instants: Instants, values: np.ndarray) -> None:
        """Lines (n, k) of a plot as they are."""
        scalars = rr.Scalars.columns(scalars=values.ravel())
        self.send(
            self.track.plot(path), instants, scalars.partition([values.shape[1]] * len(values))
        )

    def lane(self, path: str, instants: Instants, values: np.ndarray, names: list[str]) -> None:
        """A lane's state per row (n,), as an index into `names`; logged where it changes only."""
        if not len(values):
            return
        before = np.append(self._states.get(path, values[0] - 1), values[:-1])
        self._states[path] = int(values[-1])
        changed = np.flatnonzero(values != before)
        self.states(path, instants[changed], [_named(names, int(values[k])) for k in changed])

    def states(self, path: str, instants: Instants, states: list[str]) -> None:
        """Changes of a lane, as they are."""
        if states:
            self.send(self.track.plot(path), instants, rr.StateChange.columns(state=states))


def _named(names: list[str], index: int) -> str:
    """A number where this viewer knows no name."""
    return names[index] if 0 <= index < len(names) else f"number {index}"
