"""The scene in 3D: the robot, its ghost, contacts, CoM, pushes. Drawn at 50 Hz.

Footprints are drawn when they change.

A batch of rows costs one chunk per entity, so all joint placements share one entity, as named
frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from shared.config.settings import RunConfig
from shared.motion.ground import make_ground
from shared.motion.plan import make_motion
from shared.motion.plan_frame import PlanFrame
from shared.robots import Robot
from shared.telemetry.schema import FootprintKind, Schema, Source
from shared.wbc.contacts import ContactMode
from viewer.camera import focus_height
from viewer.colours import FORCE, LIMIT, SECOND_LINE
from viewer.footholds import Footholds
from viewer.ghost import Ghost
from viewer.meshes import LinkMesh
from viewer.pose import Frame, Placements, PoseModel, on_the_ground
from viewer.recorder import Recorder
from viewer.static import log_footsteps, log_ground, log_robot, log_styles
from viewer.task_time import Instants

# Scales of arrows: a contact point carries tens to hundreds of newtons, a push is about 100 N.
NEWTONS_PER_METRE = 400.0
PUSH_NEWTONS_PER_METRE = 200.0
# In a fall, forces grow without bound: no arrow is longer than that of this force [N].
MAX_FORCE = 320.0
# The arrow of a push ends this far from the base, outside the body [m].
PUSH_CLEARANCE = 0.2
# Flat marks are drawn this far above the ground, which has a grid at zero [m].
ABOVE_GROUND = np.array([0.0, 0.0, 0.002])
_SOLES = {
    FootprintKind.PLANNED: "planned_soles",
    FootprintKind.CHOSEN: "chosen_sole",
    FootprintKind.LANDED: "landed_soles",
}
# A force is at its limit when it uses this part of its friction.
AT_LIMIT = 0.99


class World:
    """Draws the scene of one robot's run; static parts at once."""

    def __init__(
        self, recorder: Recorder, robot: Robot, config: RunConfig, meshes: Sequence[LinkMesh]
    ) -> None:
        self._recorder = recorder
        track = recorder.track
        joints = sorted({1, *(mesh.joint for mesh in meshes)})
        self._ground = make_ground(config.plant_ground, seed=config.seed)
        self._pose = PoseModel(robot, joints, friction=config.wbc.friction, ground=self._ground)
        motion = make_motion(robot, config)
        self._focus = focus_height(robot)
        self._footholds = Footholds(robot)
        # Side by side, ghosts would hide the differences. A robot that steps by touch follows its
        # contact clock, and not this motion.
        follows = config.stepping.mode == "off"
        self._ghost = Ghost(robot, motion) if track.alone and follows else None
        of_robot, of_ghost = (
            {joint: f"{track.root}/{what}/{robot.model.names[joint]}" for joint in joints}
            for what in ("robot", "ghost")
        )
        self._robot_frames, self._ghost_frames = list(of_robot.values()), list(of_ghost.values())
        log_styles(recorder)
        log_robot(recorder, meshes, of_robot)
        if self._ghost is not None:
            log_robot(recorder, meshes, of_ghost, ghost=True)
            log_footsteps(recorder, robot, motion, swing_height=config.walk.swing_height)
        log_ground(recorder, self._ground)

    def log(self, schema: Schema, rows: np.ndarray, instants: Instants) -> None:
        """Draw each of these rows of the robot."""
        modes = schema.column(rows, "mode").astype(int)
        poses = zip(schema.column(rows, "q"), schema.column(rows, "f"), modes, strict=True)
        frames = [self._pose.frame(q, f, ContactMode(mode)) for q, f, mode in poses]
        self._log_joints("joints", [each.joints for each in frames], self._robot_frames, instants)
        self._log_ghost(schema, rows, instants)
        self._log_contacts(frames, instants)
        self._log_com(schema, rows, frames, instants)
        self._log_push(schema.column(rows, "push_n"), frames, instants)

    def log_steps(self, rows: np.ndarray, instants: Instants) -> None:
        """Draw the soles after the rows of footprints of each tick."""
        last = np.flatnonzero(np.append(np.diff(instants.wall_ns) != 0, True))
        drawn = []
        for of_tick in np.split(rows, last[:-1] + 1):
            self._footholds.take(of_tick)
            drawn.append(self._footholds.soles)
        for kind, entity in _SOLES.items():
            strips = [sole for soles in drawn for sole in soles[kind]]
            columns = rr.LineStrips3D.columns(strips=strips)
            counts = [len(soles[kind]) for soles in drawn]
            self._send(entity, instants[last], columns.partition(counts))

    def _log_joints(
        self, entity: str, placements: list[Placements], names: list[str], instants: Instants
    ) -> None:
        count = len(names)
        columns = rr.Transform3D.columns(
            translation=np.concatenate([each.translation for each in placements]),
            quaternion=np.concatenate([each.quat_xyzw for each in placements]),
            child_frame=names * len(placements),
            parent_frame=[self._recorder.track.frame] * (count * len(placements)),
        )
        self._send(entity, instants.repeated(count), columns)

    def _log_ghost(self, schema: Schema, rows: np.ndarray, instants: Instants) -> None:
        if self._ghost is None:
            return
        placements = []
        sources = schema.column(rows, "source").astype(int)
        times_ns = schema.column(rows, "plan_time_ns").astype(int).tolist()
        frames = schema.column(rows, "plan_in_world").tolist()
        for time_ns, frame, source in zip(times_ns, frames, sources, strict=True):
            if source == Source.STOPPING:
                self._ghost.stop(time_ns)
            q = PlanFrame(*frame).in_world(self._ghost.posture(time_ns))
            placements.append(self._pose.joints(q))
        self._log_joints("ghost_joints", placements, self._ghost_frames, instants)

    def _log_contacts(self, frames: list[Frame], instants: Instants) -> None:
        loaded = [np.linalg.norm(frame.contact_forces, axis=1) > 0.0 for frame in frames]
        counts = [int(on.sum()) for on in loaded]
        points, forces, edges, used = (
            np.concatenate(
                [getattr(frame, name)[on] for frame, on in zip(frames, loaded, strict=True)]
            )
            for name in ("contact_points", "contact_forces", "friction_edges", "friction_used")
        )
        limited, own = used >= AT_LIMIT, self._recorder.track.own_colour
        shrunk = np.maximum(1.0, np.linalg.norm(forces, axis=1) / MAX_FORCE)[:, None]
        forces, edges = forces / shrunk, edges / shrunk[:, None]
        arrows = rr.Arrows3D.columns(
            origins=points,
            vectors=forces / NEWTONS_PER_METRE,
            colors=np.where(limited[:, None], LIMIT, own(FORCE)).astype(np.uint8),
        )
        self._send("contact_forces", instants, arrows.partition(counts))
        rims = points[:, None] + edges / NEWTONS_PER_METRE
        # Two strokes draw a pyramid: round its rim and down to the tip, then across the tip.
        apex = points[:, None]
        around = np.concatenate([rims, rims[:, :1], apex, rims[:, 1:2]], axis=1)
        across = np.concatenate([rims[:, 2:3], apex, rims[:, 3:4]], axis=1)
        strips = [stroke for pair in zip(around, across, strict=True) for stroke in pair]
        colours = np.where(limited[:, None], LIMIT, SECOND_LINE).astype(np.uint8)
        cones = rr.LineStrips3D.columns(strips=strips, colors=np.repeat(colours, 2, axis=0))
        self._send("friction_cones", instants, cones.partition([2 * count for count in counts]))
        outlines = [frame.support_polygon + ABOVE_GROUND for frame in frames]
        self._send("support_polygon", instants, rr.LineStrips3D.columns(strips=outlines))

    def _log_com(
        self, schema: Schema, rows: np.ndarray, frames: list[Frame], instants: Instants
    ) -> None:
        com, reference = (schema.column(rows, name) for name in ("com", "com_reference"))
        focus = np.column_stack([com[:, :2], np.full(len(com), self._focus)])
        self._send("focus", instants, rr.Points3D.columns(positions=focus))
        for name, points in (("com", com), ("com_reference", reference)):
            below = on_the_ground(points, self._ground)
            pairs = np.stack([points, below + ABOVE_GROUND], axis=1)
            columns = rr.Points3D.columns(positions=pairs.reshape(-1, 3))
            self._send(name, instants, columns.partition([2] * len(rows)))
        plumb_lines = np.stack([com, on_the_ground(com, self._ground)], axis=1)
        self._send("com_plumb_line", instants, rr.LineStrips3D.columns(strips=plumb_lines))
        centres = np.array([frame.centre_of_pressure for frame in frames])
        known = np.isfinite(centres).all(axis=1)
        marks = rr.Points3D.columns(positions=centres[known] + ABOVE_GROUND)
        self._send("centre_of_pressure", instants, marks.partition(known.astype(int)))

    def _log_push(self, push: np.ndarray, frames: list[Frame], instants: Instants) -> None:
        """Draw a push as an arrow towards the base with its force [N]; without one, no arrow."""
        size = np.linalg.norm(push, axis=1)
        pushed = size > 0.0
        base = np.array([frame.joints.translation[0] for frame in frames])
        vectors = push[pushed] / PUSH_NEWTONS_PER_METRE
        direction = push[pushed] / size[pushed, None]
        arrows = rr.Arrows3D.columns(
            origins=base[pushed] - vectors - PUSH_CLEARANCE * direction,
            vectors=vectors,
            labels=[f"{newtons:.0f} N" for newtons in size[pushed]],
        )
        self._send("push", instants, arrows.partition(pushed.astype(int)))

    def _send(self, entity: str, instants: Instants, columns: rr.ComponentColumnList) -> None:
        self._recorder.send(self._recorder.track.world(entity), instants, columns)
