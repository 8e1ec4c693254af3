"""Conversion of the visual meshes, and their cache."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from shared.robots import Robot, load_robot
from tests.robots.biped import write_biped
from viewer.meshes import cache_folder, load_meshes, to_glb


@pytest.fixture(scope="module")
def geometry(robot: Robot) -> pin.GeometryModel:
    packages = [str(folder) for folder in robot.description.packages]
    return pin.buildGeomFromUrdf(
        robot.model, str(robot.description.urdf), pin.GeometryType.VISUAL, package_dirs=packages
    )


def test_converted_meshes_fill_the_same_box_as_pinocchio_reads_from_the_file(
    geometry: pin.GeometryModel,
) -> None:
    for shape in geometry.geometryObjects:
        converted = trimesh.load_scene(io.BytesIO(to_glb(shape)), file_type="glb")
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        # glTF stores float32 vertices; a wrong unit or up-axis is off by centimetres.
        np.testing.assert_allclose(converted.bounds, [box.min_, box.max_], atol=1e-5)


def test_meshes_keep_their_colours(geometry: pin.GeometryModel) -> None:
    head = next(shape for shape in geometry.geometryObjects if "Head" in shape.name)
    converted = trimesh.load_scene(io.BytesIO(to_glb(head)), file_type="glb")
    colours = {tuple(mesh.visual.material.main_color) for mesh in converted.geometry.values()}
    assert len(colours) > 1


def test_a_plain_shape_is_drawn_in_the_colour_of_the_urdf() -> None:
    shape = pin.GeometryObject("box", 0, pin.SE3.Identity(), pin.coal.Box(0.2, 0.4, 0.6))
    shape.meshColor = np.array([1.0, 0.0, 0.0, 1.0])
    converted = trimesh.load_scene(io.BytesIO(to_glb(shape)), file_type="glb")
    np.testing.assert_allclose(converted.extents, [0.2, 0.4, 0.6], atol=1e-6)
    (mesh,) = converted.geometry.values()
    assert tuple(mesh.visual.material.main_color[:3]) == (255, 0, 0)


def test_the_second_start_reads_the_cache(robot: Robot, tmp_path: Path) -> None:
    first = load_meshes(robot, cache=tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {f"{mesh.name}.glb" for mesh in first}
    (tmp_path / f"{first[0].name}.glb").write_bytes(b"from the cache")
    second = load_meshes(robot, cache=tmp_path)
    assert second[0].glb == b"from the cache"
    assert second[1].glb == first[1].glb


def test_a_cache_that_cannot_be_written_is_done_without(robot: Robot, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    assert len(load_meshes(robot, cache=file / "folder")) > 0


def test_the_cache_is_the_users_and_another_one_once_a_file_has_changed(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder(robot).is_relative_to(tmp_path / "remote-wbc")
    assert cache_folder(robot).name.startswith("romeo-")
    (tmp_path / "trunk.stl").touch()
    shape = '<box size="0.16 0.28 0.45"/>'
    file = write_biped(tmp_path, urdf=(shape, '<mesh filename="trunk.stl"/>'))
    before = cache_folder(load_robot(str(file)))
    (tmp_path / "trunk.stl").write_text("another trunk")
    changed = cache_folder(load_robot(str(file)))
    assert changed != before
    write_biped(tmp_path, urdf=(shape, '<mesh filename="other.stl"/>'))
    assert cache_folder(load_robot(str(file))) not in (before, changed)
