"""The robot's visual meshes as glTF, ready to be drawn.

A URDF may name COLLADA, STL or OBJ files or plain shapes. Rerun draws glTF, and refuses the COLLADA
version of some robots. Each shape is converted once, in its file's frame and with the URDF's scale.
The user's cache keeps it under the robot's name and an identity of its files.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from shared.commands import wbc
from shared.errors import UserError
from shared.robots import Robot
from shared.robots.meshes import mesh_files

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class LinkMesh:
    """A shape that a joint carries: its glTF, and its placement in the joint's frame."""

    name: str
    joint: int
    joint_from_mesh: pin.SE3
    glb: bytes


def cache_folder(robot: Robot) -> Path:
    """Return the folder of a robot's converted meshes: another one once a file has changed."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    urdf, what = robot.description.urdf, f"robot {robot.name}: urdf"
    digest = hashlib.sha256(urdf.read_bytes())
    for _, _, path in mesh_files(urdf, robot.description.packages, kind="visual", what=what):
        if path is not None:
            status = path.stat()
            digest.update(f"{path} {status.st_size} {status.st_mtime_ns}".encode())
    return Path(root) / "remote-wbc" / "meshes" / f"{robot.name}-{digest.hexdigest()[:16]}"


def load_meshes(robot: Robot, *, cache: Path | None = None) -> tuple[LinkMesh, ...]:
    """Return a robot's visual shapes, converted or cached; `UserError` if a file is missing."""
    folder = cache_folder(robot) if cache is None else cache
    packages = [str(folder) for folder in robot.description.packages]
    try:
        geometry = pin.buildGeomFromUrdf(
            robot.model, str(robot.description.urdf), pin.GeometryType.VISUAL, package_dirs=packages
        )
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"meshes of {robot.name}: expected files that can be read, got: {reason}; try "
            f"{wbc('robot')} check, or packages in the robot file"
        ) from None
    return tuple(
        LinkMesh(
            name=shape.name,
            joint=shape.parentJoint,
            joint_from_mesh=pin.SE3(shape.placement),
            glb=_converted(shape, folder / f"{shape.name.replace('/', '_')}.glb"),
        )
        for shape in geometry.geometryObjects
    )


def _converted(shape: pin.GeometryObject, cached: Path) -> bytes:
    try:
        return cached.read_bytes()
    except OSError:
        glb = to_glb(shape)
    temporary = cached.with_suffix(f".{os.getpid()}")
    try:
        cached.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(glb)
        temporary.replace(cached)
    except OSError:
        pass  # A read-only home costs only a conversion at each start.
    return glb


def to_glb(shape: pin.GeometryObject) -> bytes:
    """Return a visual shape of Pinocchio's geometry as binary glTF."""
    # Imported here: it loads as long as all else, and meshes from the cache do not need it.
    import trimesh

    plain = _plain_shape(shape.geometry)
    scene = trimesh.Scene(plain) if plain is not None else trimesh.load_scene(shape.meshPath)
    colour = (np.clip(shape.meshColor, 0.0, 1.0) * 255).astype(np.uint8)
    for mesh in scene.geometry.values():
        if shape.overrideMaterial or not mesh.visual.defined:
            material = trimesh.visual.material.PBRMaterial(baseColorFactor=colour)
            mesh.visual = trimesh.visual.TextureVisuals(material=material)
    if plain is None:
        scene.apply_transform(np.diag([*shape.meshScale, 1.0]))
    return bytes(scene.export(file_type="glb"))


def _plain_shape(geometry: pin.coal.CollisionGeometry) -> trimesh.Trimesh | None:
    """Return a box, sphere, cylinder or capsule as a mesh; None if it comes from a file."""
    import trimesh

    shape: trimesh.Trimesh | None = None
    if isinstance(geometry, pin.coal.Box):
        shape = trimesh.creation.box(extents=2.0 * geometry.halfSide)
    elif isinstance(geometry, pin.coal.Sphere):
        shape = trimesh.creation.icosphere(radius=geometry.radius)
    elif isinstance(geometry, pin.coal.Cylinder):
        shape = trimesh.creation.cylinder(geometry.radius, 2.0 * geometry.halfLength)
    elif isinstance(geometry, pin.coal.Capsule):
        shape = trimesh.creation.capsule(2.0 * geometry.halfLength, geometry.radius)
    return shape
