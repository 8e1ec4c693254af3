"""The sole of a foot, read off the collision geometry of its URDF."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from shared.errors import ConfigError
from shared.robots.description import Foot, RobotDescription, Sole
from shared.robots.meshes import mesh_files

# The sole is the section this far above the lowest point, because edges are often rounded [m].
SECTION = 0.001


def collision_sole(
    description: RobotDescription, model: pin.Model, side: Foot, joint: int, placement: pin.SE3
) -> tuple[Sole, float]:
    """Return the rectangle around the section of a foot's shapes just above their lowest point.

    `placement` is that of the sole frame on `joint`. The second value is the height of the lowest
    point in that frame [m]. Raise `ConfigError` if the joint has no shapes that can be cut.
    """
    what = f"robot {description.name}: feet.{side.value}.sole"
    files = mesh_files(description.urdf, description.packages, kind="collision", what=what)
    for link, name, path in files:
        if path is None:
            folders = " or ".join(map(str, description.packages))
            raise ConfigError(
                f"{what}: expected the mesh {name!r} of link {link} in {folders}, got no such "
                "file; try packages, the folders of packages, or sole = { x = […], y = […] }"
            )
    try:
        geometry = pin.buildGeomFromUrdf(
            model,
            str(description.urdf),
            pin.GeometryType.COLLISION,
            package_dirs=[str(folder) for folder in description.packages],
        )
    except ValueError as error:
        reason = [line for line in str(error).splitlines() if line.startswith("message:")]
        raise ConfigError(
            f"{what}: expected meshes that can be read, got {' '.join(reason) or error}; try "
            "another file, or sole = { x = […], y = […] }"
        ) from None
    shapes = [each for each in geometry.geometryObjects if each.parentJoint == joint]
    meshes = [(placement.actInv(each.placement), _triangles(each, what=what)) for each in shapes]
    if not meshes:
        raise ConfigError(
            f"{what}: expected collision shapes on joint {model.names[joint]}, got none; try "
            "sole = { x = […], y = […] }"
        )
    cut = [points @ M.rotation.T + M.translation for M, points in meshes]
    lowest = min(float(points[..., 2].min()) for points in cut)
    section = np.vstack([_section(points, lowest + SECTION) for points in cut])
    (x0, y0), (x1, y1) = section.min(axis=0), section.max(axis=0)
    return Sole(side, (float(x0), float(x1)), (float(y0), float(y1))), lowest


def _triangles(shape: Any, *, what: str) -> np.ndarray:
    """Corners of a shape's triangles in its own frame, (n, 3 corners, 3)."""
    import coal
    import trimesh

    geometry = shape.geometry
    if isinstance(geometry, coal.BVHModelBase):
        points = geometry.vertices()
        if points.shape[1] != 3:
            points = points.T
        corners = [geometry.tri_indices(k) for k in range(geometry.num_tris)]
        indices = np.array([[each[0], each[1], each[2]] for each in corners])
        return np.asarray(points[indices], dtype=float)
    if isinstance(geometry, coal.Box):
        mesh = trimesh.creation.box(extents=2.0 * geometry.halfSide)
    elif isinstance(geometry, coal.Sphere):
        mesh = trimesh.creation.icosphere(subdivisions=4, radius=geometry.radius)
    elif isinstance(geometry, coal.Cylinder):
        mesh = trimesh.creation.cylinder(geometry.radius, 2.0 * geometry.halfLength, sections=256)
    elif isinstance(geometry, coal.Capsule):
        mesh = trimesh.creation.capsule(2.0 * geometry.halfLength, geometry.radius, count=(64, 64))
    else:
        raise ConfigError(
            f"{what}: expected meshes, boxes, spheres, cylinders or capsules, got {shape.name}, a "
            f"{type(geometry).__name__}; try sole = {{ x = […], y = […] }}"
        )
    return np.asarray(mesh.triangles, dtype=float)


def _section(triangles: np.ndarray, height: float) -> np.ndarray:
    """Points (n, 2) of triangles at or below a height, and where their edges cross it."""
    below = triangles[triangles[..., 2] <= height]
    found = [below[:, :2]]
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        crossing = (a[:, 2] - height) * (b[:, 2] - height) < 0.0
        a, b = a[crossing], b[crossing]
        part = (height - a[:, 2]) / (b[:, 2] - a[:, 2])
        found.append((a + part[:, None] * (b - a))[:, :2])
    return np.vstack(found)
