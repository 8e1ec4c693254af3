"""The static part of a recording: meshes, footsteps, colours, sizes, names and units.

It is logged once, without a time. Servers and files keep it for the whole run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from shared.motion.ground import HOLE, Ground
from shared.motion.swing import swing
from shared.motion.walking import Walking
from shared.robots import Foot, Robot
from shared.wbc.reference import Motion
from viewer.colours import (
    CHOSEN,
    COM,
    LANDED,
    LEFT_FOOT,
    LIMIT,
    LINE,
    PLAN,
    PRESSURE,
    PUSH,
    RIGHT_FOOT,
    SUPPORT,
    Colour,
)
from viewer.footholds import outline, sole_corners
from viewer.meshes import LinkMesh
from viewer.plots import LANES, LINKS, OVERRUN_PATH, SOLVE_SERIES, TICK_SERIES
from viewer.recorder import Recorder

GHOST_COLOUR = (90, 160, 255, 64)
# The ghost is smaller, so that it hides inside the robot where both are at the same place.
GHOST_SCALE = 0.985
_FOOT_COLOURS: dict[Foot, Colour] = {Foot.LEFT: LEFT_FOOT, Foot.RIGHT: RIGHT_FOOT}
_SWING_POINTS = 20
_GROUND_COLOUR: Colour = (70, 74, 82)
_FORBIDDEN_COLOUR: Colour = (110, 55, 55)
_EDGE_COLOUR: Colour = (130, 136, 148)
_GROUND_DEPTH = 0.02


def log_styles(recorder: Recorder) -> None:
    """Log the colours, sizes and names of everything that will be drawn or plotted."""
    recording, track = recorder.recording, recorder.track
    own = track.own_colour
    plan = PLAN if track.alone else LINE
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if not track.alone:
        recording.log(track.root, rr.Transform3D(translation=track.offset), static=True)
    styles = {
        "contact_forces": rr.Arrows3D.from_fields(radii=[0.007]),
        "friction_cones": rr.LineStrips3D.from_fields(radii=[0.0012]),
        "push": rr.Arrows3D.from_fields(colors=[PUSH], radii=[0.015]),
        # A centre of mass, then its projection on the ground.
        "com": rr.Points3D.from_fields(colors=[own(COM)], radii=[0.02, 0.012]),
        "com_reference": rr.Points3D.from_fields(colors=[plan], radii=[0.02, 0.012]),
        # Inside the robot, too small to be seen.
        "focus": rr.Points3D.from_fields(colors=[LINE], radii=[0.0005]),
        "com_plumb_line": rr.LineStrips3D.from_fields(colors=[own(COM)], radii=[0.004]),
        "centre_of_pressure": rr.Points3D.from_fields(colors=[own(PRESSURE)], radii=[0.014]),
        "planned_soles": rr.LineStrips3D.from_fields(colors=[plan], radii=[0.003]),
        "chosen_sole": rr.LineStrips3D.from_fields(colors=[own(CHOSEN)], radii=[0.006]),
        "landed_soles": rr.LineStrips3D.from_fields(colors=[LANDED], radii=[0.002]),
        "support_polygon": rr.LineStrips3D.from_fields(colors=[own(SUPPORT)], radii=[0.004]),
    }
    for name, style in styles.items():
        recording.log(track.world(name), style, static=True)
    for series in (*TICK_SERIES, SOLVE_SERIES):
        _log_lines(recorder, series.path, series.names, series.colours)
    for link in LINKS:
        _log_lines(recorder, link.path, (link.name,), (LINE,))
        _log_marks(recorder, link.lost_path, f"{link.name}, lost")
    _log_marks(recorder, OVERRUN_PATH, "overrun")
    for lane in LANES:
        states, colours = list(lane.states), list(lane.states.values())
        configuration = rr.StateConfiguration(values=states, labels=states, colors=colours)
        recording.log(track.plot(lane.path), configuration, static=True)


def log_robot(
    recorder: Recorder,
    meshes: Sequence[LinkMesh],
    frames: dict[int, str],
    *,
    ghost: bool = False,
) -> None:
    """Log the meshes, translucent for a ghost; `frames` names the frame of each joint."""
    folder = recorder.track.world("ghost" if ghost else "robot")
    for mesh in meshes:
        placement = mesh.joint_from_mesh
        frame = frames[mesh.joint]
        recorder.recording.log(
            f"{folder}/{mesh.name}",
            rr.Asset3D(
                contents=mesh.glb,
                media_type=rr.MediaType.GLB,
                albedo_factor=GHOST_COLOUR if ghost else None,
            ),
            rr.CoordinateFrame(f"{frame}/{mesh.name}"),
            rr.Transform3D(
                translation=placement.translation,
                mat3x3=placement.rotation * (GHOST_SCALE if ghost else 1.0),
                parent_frame=frame,
                child_frame=f"{frame}/{mesh.name}",
            ),
            static=True,
        )


def log_footsteps(recorder: Recorder, robot: Robot, motion: Motion, *, swing_height: float) -> None:
    """Log the planned soles of a walk as outlines, and the swing foot's paths between them."""
    if not isinstance(motion, Walking):
        return
    soles = sole_corners(robot)
    first = motion.steps[0]
    prints = [first.support, first.start, *(step.goal for step in motion.steps)]
    outlines = rr.LineStrips3D(
        [outline(each, soles[each.foot]) for each in prints],
        colors=[_FOOT_COLOURS[each.foot] for each in prints],
        radii=[0.0025],
    )
    ways = [
        [
            swing(
                step.start, step.goal, time=u, duration=1.0, height=swing_height + step.obstacle
            ).position
            for u in np.linspace(0.0, 1.0, _SWING_POINTS)
        ]
        for step in motion.steps
    ]
    paths = rr.LineStrips3D(
        ways, colors=[_FOOT_COLOURS[step.swing_foot] for step in motion.steps], radii=[0.0015]
    )
    track = recorder.track
    recorder.recording.log(track.world("footsteps"), outlines, static=True)
    recorder.recording.log(track.world("swing_paths"), paths, static=True)


def log_ground(recorder: Recorder, ground: Ground) -> None:
    """Log the patches of a ground as boxes that reach down to the lowest one."""
    patches = [patch for patch in ground.patches if patch.z > HOLE]
    if not patches:
        return
    bottom = min(0.0, *(min(patch.z, patch.middle) for patch in patches)) - _GROUND_DEPTH
    centres, halves, turns = [], [], []
    for patch in patches:
        centre, half, tilt = patch.box((patch.middle - bottom) / 2)
        centres.append(centre)
        halves.append(half)
        turns.append([0.0, -math.sin(tilt / 2), 0.0, math.cos(tilt / 2)])
    boxes = rr.Boxes3D(
        centers=centres,
        half_sizes=halves,
        quaternions=turns,
        colors=[_GROUND_COLOUR if each.allowed else _FORBIDDEN_COLOUR for each in patches],
        fill_mode="solid",
    )
    recorder.recording.log(recorder.track.world("ground"), boxes, static=True)
    edges = rr.Boxes3D(
        centers=centres, half_sizes=halves, quaternions=turns, colors=[_EDGE_COLOUR], radii=[0.001]
    )
    recorder.recording.log(recorder.track.world("ground_edges"), edges, static=True)


def _log_lines(
    recorder: Recorder, path: str, names: Sequence[str], colours: Sequence[Colour]
) -> None:
    track = recorder.track
    lines = rr.SeriesLines(
        names=[track.line_name(name) for name in names],
        colors=[track.own_colour(colour) for colour in colours],
    )
    recorder.recording.log(track.plot(path), lines, static=True)


def _log_marks(recorder: Recorder, path: str, name: str) -> None:
    track = recorder.track
    marks = rr.SeriesPoints(
        colors=[track.own_colour(LIMIT)],
        names=[track.line_name(name)],
        markers=["cross"],
        marker_sizes=[5.0],
    )
    recorder.recording.log(track.plot(path), marks, static=True)
