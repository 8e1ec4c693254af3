"""Draw telemetry rows into a rerun recording: the robot in 3D, and the plots.

All data are on two timelines, the task time and the robot's clock. The 3D scene is drawn at 50 Hz;
plots keep the peaks of all rows (`viewer.plots`). While the robot waits for the edge, task time is
−1 ns and only its newest pose is drawn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
import rerun as rr

from shared.config.settings import RunConfig
from shared.errors import UserError
from shared.robots import Robot
from shared.telemetry.outages import OUTAGE, SILENT, Change, LinkLane
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA, Schema, tick_schema
from viewer.meshes import LinkMesh
from viewer.plots import (
    LANES,
    LINK_LANES,
    LINKS,
    MODE_LANE,
    OVERRUN_PATH,
    SOLE_LANES,
    SOLVE_SERIES,
    SOURCE_LANE,
    TICK_SERIES,
    link_delay,
    milliseconds,
)
from viewer.recorder import NO_STATE, Recorder
from viewer.soles import sole_states
from viewer.task_time import Instants, TaskTime
from viewer.track import Track
from viewer.verdict import Verdict
from viewer.world import World

FRAME_NS = 20_000_000
# Blocks of messages kept from before the robot's first row; older ones are dropped.
MAX_WAITING_BLOCKS = 64
_ALONE = Track()


class Scene:
    """Logs rows of one robot's run to `recording`, which must have its sinks already."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        robot: Robot,
        config: RunConfig,
        *,
        meshes: Sequence[LinkMesh],
        track: Track = _ALONE,
    ) -> None:
        self._robot = robot
        self._recorder = Recorder(recording, track)
        self._world = World(self._recorder, robot, config, meshes)
        self._task_time = TaskTime()
        self._waiting: deque[tuple[Schema, np.ndarray]] = deque(maxlen=MAX_WAITING_BLOCKS)
        # The robot sends all the time; the edge may have nothing to send.
        self._lanes = [LinkLane(steady=True), LinkLane()]
        self._last_frame: int | None = None
        self._last_wall_ns = 0
        self._overruns: float | None = None
        self._tick_columns = _columns(tick_schema(nq=robot.model.nq, nv=robot.model.nv))
        self._verdict = Verdict(robot)
        self._last: Instants | None = None

    @property
    def verdict(self) -> str:
        """Return whether the robot waits, stands or has fallen, in words."""
        return self._verdict.text

    def log_rows(self, schema: Schema, rows: np.ndarray) -> None:
        """Draw rows of any of the four kinds; raise `UserError` if they do not fit this robot."""
        columns = _columns(schema)
        if not len(rows):
            return
        if columns == self._tick_columns:
            self._log_ticks(schema, rows)
        elif columns in (_columns(each) for each in (LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA)):
            self._waiting.append((schema, rows))
        else:
            raise UserError(_unexpected(columns, self._tick_columns, robot=self._robot.name))
        while self._waiting and self._task_time.known:
            self._log_messages(*self._waiting.popleft())

    def look_for_silence(self, *, patience_ns: int) -> None:
        """Mark an outage of the uplink if no message passed it in the robot's last `patience_ns`.

        A message that the link holds for ever never gets a row, so rows alone do not show it.
        """
        uplink, downlink = self._lanes
        stalled = uplink.silent(self._last_wall_ns, OUTAGE, patience_ns=patience_ns)
        if stalled:
            self._log_link_states(0, stalled)
            # Without states the edge sends nothing, so the downlink shows no outage.
            self._log_link_states(1, downlink.silent(self._last_wall_ns, SILENT, patience_ns=0))

    def finish(self) -> None:
        """End the lanes at the run's last row, except the lane that shows a fall."""
        if self._last is None:
            return
        for lane in LANES:
            if lane is not SOURCE_LANE or not self._verdict.fallen:
                self._recorder.states(lane.path, self._last, [""])

    def _log_ticks(self, schema: Schema, rows: np.ndarray) -> None:
        wall_ns = schema.column(rows, "wall_ns").astype(np.int64)
        time_ns = schema.column(rows, "time_ns").astype(np.int64)
        instants = self._task_time.instants(wall_ns, time_ns)
        running = time_ns >= 0
        if running.any():
            self._task_time.learn(wall_ns[running], time_ns[running])
        frame = np.where(running, time_ns // FRAME_NS, -1)
        previous = np.append(-1 if self._last_frame is None else self._last_frame, frame[:-1])
        drawn = (frame != previous) & running
        if not running.all():
            drawn[np.flatnonzero(~running)[-1]] = True
        drawn &= np.isfinite(schema.column(rows, "q")).all(axis=1)
        self._last_frame = int(frame[-1])
        self._last_wall_ns = int(wall_ns[-1])
        if drawn.any():
            self._world.log(schema, rows[drawn], instants[drawn])
        self._plot_ticks(schema, rows[running], instants[running])

    def _plot_ticks(self, schema: Schema, rows: np.ndarray, instants: Instants) -> None:
        if not len(rows):
            return
        for series in TICK_SERIES:
            self._recorder.peaks(series.path, instants, series.values(schema, rows))
        self._last = instants[-1:]
        self._log_lanes(schema, rows, instants)
        overruns = schema.column(rows, "overruns")
        # Overruns in the first row come from the wait, or from before this viewer was started.
        before = overruns[0] if self._overruns is None else self._overruns
        overrun = np.diff(overruns, prepend=before) > 0
        self._overruns = float(overruns[-1])
        if overrun.any():
            took = milliseconds(schema.column(rows, "tick_ns")[overrun])
            self._recorder.lines(OVERRUN_PATH, instants[overrun], took[:, None])

    def _log_lanes(self, schema: Schema, rows: np.ndarray, instants: Instants) -> None:
        """Log the source of the commands, the contact mode, and the limits of both soles.

        A robot that has fallen has none of them.
        """
        fallen = self._verdict.take(schema, rows)
        sources, modes = (
            np.where(fallen, len(lane.states) - 1 if lane is SOURCE_LANE else NO_STATE, values)
            for lane, values in (
                (SOURCE_LANE, schema.column(rows, "source").astype(int)),
                (MODE_LANE, schema.column(rows, "mode").astype(int)),
            )
        )
        self._recorder.lane(SOURCE_LANE.path, instants, sources, list(SOURCE_LANE.states))
        self._recorder.lane(MODE_LANE.path, instants, modes, list(MODE_LANE.states))
        first, feet = sole_states(schema, rows)
        for lane, states in zip(SOLE_LANES, feet, strict=True):
            names = list(lane.states)
            indices = np.array([names.index(each) if each else NO_STATE for each in states])
            self._recorder.lane(
                lane.path, instants[first], np.where(fallen[first], NO_STATE, indices), names
            )

    def _log_messages(self, schema: Schema, rows: np.ndarray) -> None:
        wall_ns = schema.column(rows, "wall_ns").astype(np.int64)
        if "landing_ns" in schema.slices:
            time_ns = schema.column(rows, "time_ns").astype(np.int64)
            self._world.log_steps(rows, self._task_time.instants(wall_ns, time_ns))
            return
        instants = self._task_time.from_wall(wall_ns)
        in_task = instants.task_ns >= 0
        rows, wall_ns, instants = rows[in_task], wall_ns[in_task], instants[in_task]
        if "solve_ns" in schema.slices:
            self._recorder.peaks(SOLVE_SERIES.path, instants, SOLVE_SERIES.values(schema, rows))
            return
        direction = schema.column(rows, "direction")
        for link in LINKS:
            chosen = direction == link.direction
            delays = link_delay(schema, rows[chosen])
            self._recorder.peaks(link.path, instants[chosen], delays)
            lost = np.isnan(delays[:, 0])
            if lost.any():
                marks = milliseconds(schema.column(rows[chosen][lost], "nominal_ns"))[:, None]
                self._recorder.lines(link.lost_path, instants[chosen][lost], marks)
            took_ns = schema.column(rows[chosen], "achieved_ns").astype(np.int64)
            changes = self._lanes[link.direction].add(wall_ns[chosen], took_ns)
            self._log_link_states(link.direction, changes)

    def _log_link_states(self, direction: int, changes: list[Change]) -> None:
        if changes:
            instants = self._task_time.from_wall(np.array([at_ns for at_ns, _ in changes]))
            states = [state for _, state in changes]
            self._recorder.states(LINK_LANES[direction].path, instants, states)


def _columns(schema: Schema) -> dict[str, int]:
    return {column.name: column.width for column in schema.columns}


def _unexpected(columns: dict[str, int], expected: dict[str, int], *, robot: str) -> str:
    missing = [name for name in expected if name not in columns]
    if missing:
        return f"telemetry: expected columns of a robot, link, edge or step; missing {missing}"
    differing = [
        f"{name} ({width} instead of {expected[name]})"
        for name, width in columns.items()
        if name in expected and width != expected[name]
    ]
    return f"telemetry: not of the robot {robot}: {', '.join(differing) or 'unknown columns'}"
