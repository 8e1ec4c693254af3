from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from robot_node.mjcf import mjcf
from shared.config.robot_settings import PlantConfig
from shared.robots import CATALOGUE, load_robot


@pytest.fixture(scope="module", params=list(CATALOGUE))
def robot(request):
    return load_robot(request.param)


@pytest.fixture(scope="module")
def generated(robot):
    return mujoco.MjModel.from_xml_string(mjcf(robot, PlantConfig(), timestep=1e-3))


def test_both_models_have_the_same_joints_in_the_same_order(generated, robot):
    names = [generated.joint(k).name for k in range(generated.njnt)]
    assert names == list(robot.model.names)[1:]
    nv = robot.model.nv
    assert (generated.nq, generated.nv, generated.nu) == (nv + 1, nv, nv - 6)


def test_every_joint_but_the_base_has_a_motor_of_gain_one(generated, robot):
    motors = [generated.actuator(k).name for k in range(generated.nu)]
    assert motors == list(robot.model.names)[2:]
    np.testing.assert_array_equal(generated.actuator_gear[:, 0], 1.0)
    np.testing.assert_array_equal(generated.actuator_gainprm[:, 0], 1.0)


def test_bodies_have_the_mass_of_the_robot(generated, robot):
    assert generated.body_mass.sum() == pytest.approx(robot.mass, rel=1e-12)


def test_nothing_is_added_to_the_dynamics(generated):
    np.testing.assert_array_equal(generated.dof_armature, 0.0)
    np.testing.assert_array_equal(generated.dof_damping, 0.0)
    np.testing.assert_array_equal(generated.dof_frictionloss, 0.0)
    np.testing.assert_array_equal(generated.opt.gravity, [0.0, 0.0, -9.81])
    assert generated.opt.timestep == 1e-3


def test_contact_settings_reach_floor_and_soles(robot):
    plant = dataclasses.replace(
        PlantConfig(), friction=0.6, contact_time_constant=0.02, contact_damping_ratio=0.9
    )
    model = mujoco.MjModel.from_xml_string(mjcf(robot, plant, timestep=2e-3))
    for name in ("floor", "left_sole", "right_sole"):
        assert model.geom(name).friction[0] == pytest.approx(0.6)
        np.testing.assert_allclose(model.geom(name).solref, [0.02, 0.9])
    assert model.opt.timestep == 2e-3


def test_soles_touch_the_floor_and_not_each_other(generated):
    floor, left, right = (generated.geom(n) for n in ("floor", "left_sole", "right_sole"))

    def touch(a, b):
        return bool(a.contype[0] & b.conaffinity[0] or b.contype[0] & a.conaffinity[0])

    assert touch(floor, left)
    assert touch(floor, right)
    assert not touch(left, right)
