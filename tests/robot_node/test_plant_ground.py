"""The plant's ground is the map's, and the robot stands and walks on it."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from robot_node.plant import MujocoPlant, make_plant
from shared.config.robot_settings import PlantConfig
from shared.errors import ConfigError
from shared.motion.ground import make_ground
from shared.robots import Foot


@pytest.mark.parametrize(
    "text", ["flat", "blocks:4cm", "stairs:3x6cm", "stairs:2x-5cm", "gap:10cm", "slope:-8deg"]
)
def test_the_surface_under_every_point_is_the_map(robot, text):
    ground = make_ground(text, seed=2)
    plant = MujocoPlant(robot, PlantConfig(), ground=ground)
    # Beside the robot.
    points = np.random.default_rng(0).uniform((-0.5, 0.4), (4.5, 2.3), (300, 2))
    seen, geom = [], np.zeros(1, dtype=np.int32)
    for x, y in points.tolist():
        above, down = np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0])
        seen.append(5.0 - mujoco.mj_ray(plant.model, plant.data, above, down, None, 1, -1, geom))
    np.testing.assert_allclose(seen, ground.heights(points), atol=1e-9)


def test_level_ground_beside_blocks_bears_the_soles_as_a_floor_does(robot):
    forces = []
    for text in ("flat", "blocks:4cm"):
        plant = MujocoPlant(robot, PlantConfig(), ground=make_ground(text, seed=0))
        q = robot.q_standing.copy()
        q[2] -= 1e-3
        plant.set_state(q, np.zeros(robot.model.nv))
        forces.append(plant.contact_forces())
    for foot in Foot:
        assert forces[0][foot][2] > 100.0
        np.testing.assert_allclose(forces[1][foot], forces[0][foot], rtol=1e-6)


def test_the_rigid_plant_has_flat_ground_only(robot):
    rigid = dataclasses.replace(PlantConfig(), kind="rigid")
    make_plant(robot, rigid, timestep=1e-3)
    with pytest.raises(ConfigError, match=r"expected .*ground=…"):
        make_plant(robot, rigid, timestep=1e-3, ground=make_ground("gap:10cm", seed=0))
