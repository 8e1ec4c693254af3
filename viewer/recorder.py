"""Send columns of values, with their instants, to the entities of one run."""

from __future__ import annotations

import numpy as np
import rerun as rr

from viewer.plots import peak_rows
from viewer.task_time import Instants
from viewer.track import Track

TIMELINE = "task_time"
WALL_TIMELINE = "wall_time"
# The index of no state, which a lane shows as a gap.
NO_STATE = -1


class Recorder:
    """The part of a recording that holds the entities of one run."""

    def __init__(self, recording: rr.RecordingStream, track: Track) -> None:
        self.recording = recording
        self.track = track
        self._states: dict[str, int] = {}

    def send(self, path: str, instants: Instants, columns: rr.ComponentColumnList) -> None:
        """Send one row of `columns` for each instant."""
        self.recording.send_columns(
            path,
            [
                rr.TimeColumn(TIMELINE, duration=instants.task_ns.astype("timedelta64[ns]")),
                rr.TimeColumn(WALL_TIMELINE, duration=instants.wall_ns.astype("timedelta64[ns]")),
            ],
            columns,
        )

    def peaks(self, path: str, instants: Instants, values: np.ndarray) -> None:
        """Send lines (n, k) of a plot, thinned to their peaks."""
        kept = peak_rows(instants.task_ns, values)
        if len(kept):
            self.lines(path, instants[kept], values[kept])

    def lines(self, path: str, instants: Instants, values: np.ndarray) -> None:
        """Send lines (n, k) of a plot with every sample."""
        scalars = rr.Scalars.columns(scalars=values.ravel())
        self.send(
            self.track.plot(path), instants, scalars.partition([values.shape[1]] * len(values))
        )

    def lane(self, path: str, instants: Instants, values: np.ndarray, names: list[str]) -> None:
        """Send the changes of a lane from its state in each row (n,), an index into `names`."""
        if not len(values):
            return
        before = np.append(self._states.get(path, values[0] + 1), values[:-1])
        self._states[path] = int(values[-1])
        changed = np.flatnonzero(values != before)
        self.states(path, instants[changed], [_named(names, int(values[k])) for k in changed])

    def states(self, path: str, instants: Instants, states: list[str]) -> None:
        """Send the changes of a lane."""
        if states:
            self.send(self.track.plot(path), instants, rr.StateChange.columns(state=states))


def _named(names: list[str], index: int) -> str:
    """Return the name of a state, or its number if it has no name."""
    if index == NO_STATE:
        return ""
    return names[index] if 0 <= index < len(names) else f"number {index}"
