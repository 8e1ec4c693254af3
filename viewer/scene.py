"""From batches of telemetry rows to a rerun recording: the robot in 3D, and the plots.

Everything is on one timeline, the task time. A batch of rows costs one chunk per entity, so all
joint placements share one entity, as named frames. The 3D scene is drawn at 50 Hz; plots keep the
peaks of all rows (`viewer.plots`). While the robot waits for the edge, task time is −1 ns and
only its newest pose is drawn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
import rerun as rr

from shared.errors import UserError
from shared.robots import Robot
from shared.telemetry import LINK_SCHEMA, SOLVE_SCHEMA, Schema, tick_schema
from shared.wbc.contacts import ContactMode
from viewer.meshes import LinkMesh
from viewer.plots import (
    LINKS,
    SOLVE_SERIES,
    SOURCE_PATH,
    TICK_SERIES,
    Series,
    link_delays,
    peak_rows,
    source_name,
)
from viewer.pose import Frame, PoseModel, on_the_ground
from viewer.static import log_static
from viewer.task_time import TaskTime

TIMELINE = "task_time"
FRAME_NS = 20_000_000
# A contact point carries tens to hundreds of newtons, a push about a hundred.
NEWTONS_PER_METRE = 500.0
PUSH_NEWTONS_PER_METRE = 200.0
# The arrow of a push ends this far from the base, outside the body [m].
PUSH_CLEARANCE = 0.2
# The polygon and the projections are drawn this far above the ground, which has a grid at zero [m].
ABOVE_GROUND = np.array([0.0, 0.0, 0.002])
# Messages that came before the robot's first row; more are forgotten.
MAX_WAITING_BLOCKS = 64


class Scene:
    """Logs rows of one robot's run to `recording`, which must have its sinks already."""

    def __init__(
        self, recording: rr.RecordingStream, robot: Robot, meshes: Sequence[LinkMesh]
    ) -> None:
        self._recording = recording
        self._robot = robot
        self._joints = sorted({1, *(mesh.joint for mesh in meshes)})
        self._joint_names = [f"{robot.name}/{robot.model.names[joint]}" for joint in self._joints]
        self._pose = PoseModel(robot, self._joints)
        self._task_time = TaskTime()
        self._waiting: deque[tuple[Schema, np.ndarray]] = deque(maxlen=MAX_WAITING_BLOCKS)
        self._last_frame: int | None = None
        self._last_source: int | None = None
        self._tick_columns = _columns(tick_schema(nq=robot.model.nq, nv=robot.model.nv))
        log_static(recording, meshes, dict(zip(self._joints, self._joint_names, strict=True)))

    def log_rows(self, schema: Schema, rows: np.ndarray) -> None:
        """Draw rows of any of the three kinds; `UserError` if they are of none for this robot."""
        columns = _columns(schema)
        if not len(rows):
            return
        if columns == self._tick_columns:
            self._log_ticks(schema, rows)
        elif columns in (_columns(LINK_SCHEMA), _columns(SOLVE_SCHEMA)):
            self._waiting.append((schema, rows))
        else:
            raise UserError(_unexpected(columns, self._tick_columns, robot=self._robot.name))
        while self._waiting and self._task_time.known:
            self._log_messages(*self._waiting.popleft())

    def _log_ticks(self, schema: Schema, rows: np.ndarray) -> None:
        time_ns = schema.column(rows, "time_ns").astype(np.int64)
        running = time_ns >= 0
        if running.any():
            wall_ns = schema.column(rows, "wall_ns").astype(np.int64)
            self._task_time.learn(wall_ns[running], time_ns[running])
        frame = np.where(running, time_ns // FRAME_NS, -1)
        previous = np.append(-1 if self._last_frame is None else self._last_frame, frame[:-1])
        drawn = (frame != previous) & running
        if not running.all():
            drawn[np.flatnonzero(~running)[-1]] = True
        drawn &= np.isfinite(schema.column(rows, "q")).all(axis=1)
        self._last_frame = int(frame[-1])
        if drawn.any():
            self._log_scene(schema, rows[drawn], time_ns[drawn])
        rows, time_ns = rows[running], time_ns[running]
        for series in TICK_SERIES:
            self._log_series(series, schema, rows, time_ns)
        self._log_source(schema.column(rows, "source").astype(int), time_ns)

    def _log_messages(self, schema: Schema, rows: np.ndarray) -> None:
        time_ns = self._task_time.from_wall(schema.column(rows, "wall_ns").astype(np.int64))
        rows, time_ns = rows[time_ns >= 0], time_ns[time_ns >= 0]
        if "solve_ns" in schema.slices:
            self._log_series(SOLVE_SERIES, schema, rows, time_ns)
            return
        direction = schema.column(rows, "direction")
        for link in LINKS:
            chosen = direction == link.direction
            delays, times = link_delays(schema, rows[chosen]), time_ns[chosen]
            self._log_peaks(link.path, times, delays)
            lost = np.isnan(delays[:, 1])
            if lost.any():
                marks = np.nan_to_num(delays[lost, 0])
                self._send(link.lost_path, times[lost], rr.Scalars.columns(scalars=marks))

    def _log_scene(self, schema: Schema, rows: np.ndarray, time_ns: np.ndarray) -> None:
        modes = schema.column(rows, "mode").astype(int)
        poses = zip(schema.column(rows, "q"), schema.column(rows, "f"), modes, strict=True)
        frames = [self._pose.frame(q, f, ContactMode(mode)) for q, f, mode in poses]
        self._log_joints(frames, time_ns)
        self._log_contacts(frames, time_ns)
        com, reference = (schema.column(rows, name) for name in ("com", "com_reference"))
        for name, points in (("com", com), ("com_reference", reference)):
            pairs = np.stack([points, on_the_ground(points) + ABOVE_GROUND], axis=1)
            columns = rr.Points3D.columns(positions=pairs.reshape(-1, 3))
            self._send(f"world/{name}", time_ns, columns.partition([2] * len(rows)))
        plumb_lines = np.stack([com, on_the_ground(com)], axis=1)
        self._send("world/com_plumb_line", time_ns, rr.LineStrips3D.columns(strips=plumb_lines))
        self._log_push(schema.column(rows, "push_n"), frames, time_ns)

    def _log_joints(self, frames: list[Frame], time_ns: np.ndarray) -> None:
        count = len(self._joints)
        columns = rr.Transform3D.columns(
            translation=np.concatenate([frame.joint_translation for frame in frames]),
            quaternion=np.concatenate([frame.joint_quat_xyzw for frame in frames]),
            child_frame=self._joint_names * len(frames),
            parent_frame=["tf#/world"] * (count * len(frames)),
        )
        self._send("world/joints", np.repeat(time_ns, count), columns)

    def _log_contacts(self, frames: list[Frame], time_ns: np.ndarray) -> None:
        points = [frame.contact_points for frame in frames]
        forces = [frame.contact_forces for frame in frames]
        loaded = [np.linalg.norm(force, axis=1) > 0.0 for force in forces]
        arrows = rr.Arrows3D.columns(
            origins=np.concatenate([p[on] for p, on in zip(points, loaded, strict=True)]),
            vectors=np.concatenate([f[on] for f, on in zip(forces, loaded, strict=True)])
            / NEWTONS_PER_METRE,
        ).partition([int(on.sum()) for on in loaded])
        self._send("world/contact_forces", time_ns, arrows)
        strips = [frame.support_polygon + ABOVE_GROUND for frame in frames]
        self._send("world/support_polygon", time_ns, rr.LineStrips3D.columns(strips=strips))

    def _log_push(self, push: np.ndarray, frames: list[Frame], time_ns: np.ndarray) -> None:
        """An arrow towards the base, with its force in newtons; none when nothing pushes."""
        size = np.linalg.norm(push, axis=1)
        pushed = size > 0.0
        base = np.array([frame.joint_translation[0] for frame in frames])
        vectors = push[pushed] / PUSH_NEWTONS_PER_METRE
        direction = push[pushed] / size[pushed, None]
        arrows = rr.Arrows3D.columns(
            origins=base[pushed] - vectors - PUSH_CLEARANCE * direction,
            vectors=vectors,
            labels=[f"{newtons:.0f} N" for newtons in size[pushed]],
        )
        self._send("world/push", time_ns, arrows.partition(pushed.astype(int)))

    def _log_source(self, source: np.ndarray, time_ns: np.ndarray) -> None:
        if not len(source):
            return
        previous = np.append(-1 if self._last_source is None else self._last_source, source[:-1])
        changed = np.flatnonzero(source != previous)
        self._last_source = int(source[-1])
        if len(changed):
            names = [source_name(source[row]) for row in changed]
            self._send(SOURCE_PATH, time_ns[changed], rr.StateChange.columns(state=names))

    def _log_series(
        self, series: Series, schema: Schema, rows: np.ndarray, time_ns: np.ndarray
    ) -> None:
        self._log_peaks(series.path, time_ns, series.values(schema, rows))

    def _log_peaks(self, path: str, time_ns: np.ndarray, values: np.ndarray) -> None:
        kept = peak_rows(time_ns, values)
        if len(kept):
            scalars = rr.Scalars.columns(scalars=values[kept].ravel())
            self._send(path, time_ns[kept], scalars.partition([values.shape[1]] * len(kept)))

    def _send(self, path: str, time_ns: np.ndarray, columns: rr.ComponentColumnList) -> None:
        times = rr.TimeColumn(TIMELINE, duration=time_ns.astype("timedelta64[ns]"))
        self._recording.send_columns(path, [times], columns)


def _columns(schema: Schema) -> dict[str, int]:
    return {column.name: column.width for column in schema.columns}


def _unexpected(columns: dict[str, int], expected: dict[str, int], *, robot: str) -> str:
    missing = [name for name in expected if name not in columns]
    if missing:
        return f"telemetry: expected the columns of a robot, a link or an edge; missing {missing}"
    differing = [
        f"{name} ({width} instead of {expected[name]})"
        for name, width in columns.items()
        if name in expected and width != expected[name]
    ]
    return f"telemetry: not of the robot {robot}: {', '.join(differing) or 'unknown columns'}"
