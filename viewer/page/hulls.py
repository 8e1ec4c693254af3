"""The robot as few triangles: for each visual shape, the hull of its outermost points.

The points are the extremes along 26 directions: the faces, edges and corners of a cube. The user's
cache keeps the hulls beside the converted meshes.
"""

from __future__ import annotations

import io
import itertools
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shared.robots import Robot
from viewer.meshes import LinkMesh, cache_folder, load_meshes

_VERSION = 1
_DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_DIGITS = 4


def load_hulls(robot: Robot, *, cache: Path | None = None) -> dict[str, Any]:
    """Return the hulls as the page reads them, made once and then cached.

    `joints` are the numbers of the joints that carry shapes. Each of `shapes` has an index `joint`
    into them, and `vertices` (n, 3) [m] in the joint's frame. Its `faces` (m, 3) are
    counter-clockwise from outside, and its `colour` (3,) is from 0 to 255.
    """
    file = (cache_folder(robot) if cache is None else cache) / f"hulls-{_VERSION}.json"
    try:
        hulls: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        hulls = make_hulls(load_meshes(robot, cache=cache))
    else:
        return hulls
    temporary = file.with_suffix(f".{os.getpid()}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(hulls), encoding="utf-8")
        temporary.replace(file)
    except OSError:
        pass  # A read-only home costs only a conversion at each start.
    return hulls


def make_hulls(meshes: Sequence[LinkMesh]) -> dict[str, Any]:
    """Return the hulls of a robot's meshes; `load_hulls` has their form."""
    joints = sorted({1, *(mesh.joint for mesh in meshes)})
    shapes = [shape for mesh in meshes if (shape := _hull(mesh, joints)) is not None]
    return {"joints": joints, "shapes": shapes}


def _hull(mesh: LinkMesh, joints: Sequence[int]) -> dict[str, Any] | None:
    """Return the hull of a mesh in its joint's frame; None if it has no volume."""
    # Imported here: it loads as long as all else, and hulls from the cache do not need it.
    import trimesh

    scene = trimesh.load_scene(io.BytesIO(mesh.glb), file_type="glb")
    whole = scene.to_mesh()
    if not len(whole.vertices):
        return None
    outermost = np.unique(np.argmax(whole.vertices @ _DIRECTIONS.T, axis=0))
    points = whole.vertices[outermost]
    try:
        hull = trimesh.Trimesh(points).convex_hull
    except ValueError:
        return None
    placement = mesh.joint_from_mesh
    vertices = hull.vertices @ placement.rotation.T + placement.translation
    largest = max(scene.geometry.values(), key=lambda each: float(each.area))
    colour = np.asarray(largest.visual.material.main_color)[:3]
    return {
        "joint": joints.index(mesh.joint),
        "vertices": np.round(vertices, _DIGITS).tolist(),
        "faces": hull.faces.tolist(),
        "colour": colour.tolist(),
    }
