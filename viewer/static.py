"""What of the scene never changes: the robot's meshes, colours, sizes, names and units.

It is logged once, without a time, and kept by every server and file however long the run.
"""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from shared.report import SOURCES
from viewer.meshes import LinkMesh
from viewer.plots import (
    BLUE,
    GREEN,
    LINK_COLOURS,
    LINK_NAMES,
    LINKS,
    ORANGE,
    RED,
    SOLVE_SERIES,
    SOURCE_COLOURS,
    SOURCE_PATH,
    TICK_SERIES,
    YELLOW,
    Colour,
)


def log_static(
    recording: rr.RecordingStream, meshes: Sequence[LinkMesh], frames: dict[int, str]
) -> None:
    """Log it. `frames` names the coordinate frame of each joint that carries a mesh."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for mesh in meshes:
        _log_mesh(recording, mesh, frame=frames[mesh.joint])
    styles = {
        "contact_forces": rr.Arrows3D.from_fields(colors=[GREEN], radii=[0.008]),
        "push": rr.Arrows3D.from_fields(colors=[RED], radii=[0.015]),
        # A centre of mass, then its projection on the ground.
        "com": rr.Points3D.from_fields(colors=[ORANGE], radii=[0.02, 0.01]),
        "com_reference": rr.Points3D.from_fields(colors=[BLUE], radii=[0.02, 0.01]),
        "com_plumb_line": rr.LineStrips3D.from_fields(colors=[ORANGE], radii=[0.004]),
        "support_polygon": rr.LineStrips3D.from_fields(colors=[YELLOW], radii=[0.004]),
    }
    for name, style in styles.items():
        recording.log(f"world/{name}", style, static=True)
    for series in (*TICK_SERIES, SOLVE_SERIES):
        _log_lines(recording, series.path, series.names, series.colours)
    for link in LINKS:
        _log_lines(recording, link.path, LINK_NAMES, LINK_COLOURS)
        marks = rr.SeriesPoints(colors=[RED], names=["lost"], markers=["cross"], marker_sizes=[5.0])
        recording.log(link.lost_path, marks, static=True)
    states = rr.StateConfiguration(values=SOURCES, labels=SOURCES, colors=SOURCE_COLOURS)
    recording.log(SOURCE_PATH, states, static=True)


def _log_mesh(recording: rr.RecordingStream, mesh: LinkMesh, *, frame: str) -> None:
    placement = mesh.joint_from_mesh
    recording.log(
        f"world/robot/{mesh.name}",
        rr.Asset3D(contents=mesh.glb, media_type=rr.MediaType.GLB),
        rr.CoordinateFrame(f"{frame}/{mesh.name}"),
        rr.Transform3D(
            translation=placement.translation,
            mat3x3=placement.rotation,
            parent_frame=frame,
            child_frame=f"{frame}/{mesh.name}",
        ),
        static=True,
    )


def _log_lines(
    recording: rr.RecordingStream, path: str, names: Sequence[str], colours: Sequence[Colour]
) -> None:
    recording.log(path, rr.SeriesLines(names=names, colors=colours), static=True)
