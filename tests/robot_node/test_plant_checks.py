"""The plants of the project and of the example pass the checks; a wrong convention is found."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from examples.own_plant import FOLDER, MjcfPlant
from robot_node.plant import MujocoPlant, make_plant
from robot_node.plant_checks import CHECKS, plant_faults
from shared.config.robot_settings import PlantConfig
from shared.robots import Foot, load_robot


@pytest.fixture(scope="module")
def biped():
    return load_robot(str(FOLDER / "biped.toml"))


@pytest.mark.parametrize("kind", ["mujoco", "rigid"])
@pytest.mark.parametrize("name", ["romeo", "biped"])
def test_a_plant_of_the_project_passes_every_check(kind, name, robot, biped):
    any_robot = robot if name == "romeo" else biped
    make = partial(make_plant, any_robot, PlantConfig(kind=kind), timestep=1e-3)
    found = plant_faults(make, any_robot)
    assert list(found) == list(CHECKS)
    assert not any(found.values())


def test_the_plant_of_somebody_elses_model_passes_every_check(biped):
    make = partial(MjcfPlant, biped, PlantConfig(), timestep=1e-3)
    assert not any(plant_faults(make, biped).values())


class WorldVelocity(MujocoPlant):
    """As MuJoCo has it: the base's linear velocity in the world."""

    def state(self):
        q, v = super().state()
        v[:3] = self.data.qvel[:3]
        return q, v


class ScalarFirst(MujocoPlant):
    def state(self):
        q, v = super().state()
        return np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]]), v


class Shared(MujocoPlant):
    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        self._q = super().state()[0]

    def set_state(self, q, v):
        super().set_state(q, v)
        self._q = q.copy()

    def state(self):
        return self._q, super().state()[1]


class Unscaled(MujocoPlant):
    def contact_forces(self):
        return {foot: 0.001 * force for foot, force in super().contact_forces().items()}


class OneFoot(MujocoPlant):
    def contact_forces(self):
        return {Foot.LEFT: super().contact_forces()[Foot.LEFT]}


class Turned(MujocoPlant):
    def step(self, tau, *, push):
        super().step(tau, push=push[[1, 0, 2]])


class Reversed(MujocoPlant):
    def step(self, tau, *, push):
        super().step(-tau, push=push)


class Remembering(MujocoPlant):
    count = 0

    def step(self, tau, *, push):
        self.count += 1
        super().step(tau + 1e-3 * self.count, push=push)


@pytest.mark.parametrize(
    ("plant", "check", "message"),
    [
        (WorldVelocity, "q moves by v, in Pinocchio's convention", "velocities in the base frame"),
        (ScalarFirst, "state() returns copies of the state that was set", "x, y, z, w"),
        (Shared, "state() returns copies of the state that was set", "return copies"),
        (Unscaled, "contact forces bear the weight", "in newtons"),
        (OneFoot, "contact forces bear the weight", "for each foot"),
        (Turned, "a push moves the base in the world", "a push along x of the world"),
        (Reversed, "torques accelerate their joints", "the order and the signs of motors"),
        (Remembering, "the same steps give the same state", "set_state has to reset"),
    ],
)
def test_a_plant_with_another_convention_fails_the_check_that_names_it(
    biped, plant, check, message
):
    found = plant_faults(partial(plant, biped, PlantConfig(), timestep=1e-3), biped)
    assert message in found[check][0]
