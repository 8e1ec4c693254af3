"""MuJoCo's robot is Pinocchio's robot: same inertia, same bias force, same accelerations.

The tolerance is the requirement, 1e-9 relative to the largest entry. Measured over the fifty
states: 5e-16 on M, 5e-16 on h, 1e-13 on accelerations.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from robot_node.plant import MujocoPlant, from_mujoco, to_mujoco, world_from_base
from shared.motion.standing import Standing
from shared.robots import CATALOGUE, load_robot
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.projector import solve
from shared.wbc.qp import DaqpSolver
from shared.wbc.stack import make_stacks
from shared.wbc.torque import recover_torque
from tests.states import random_state, random_states

TOLERANCE = 1e-9


# What tests/conftest.py makes once for Romeo is made here for each robot.
@pytest.fixture(scope="module", params=list(CATALOGUE))
def robot(request):
    return load_robot(request.param)


@pytest.fixture(scope="module")
def model(robot):
    return WholeBodyModel(robot)


@pytest.fixture(scope="module")
def reference(robot):
    return Standing(robot).reference(0)


@pytest.fixture(scope="module")
def stacks(robot, config):
    return make_stacks(robot, config.wbc)


@pytest.fixture(scope="module")
def states(robot):
    return random_states(robot, count=50, rng=np.random.default_rng(20))


@pytest.fixture(scope="module")
def plant(robot, config):
    return MujocoPlant(robot, config.plant)


@pytest.fixture(scope="module")
def in_the_air(robot, config):
    """A plant without contacts, so that forward dynamics is of the robot alone."""
    plant = MujocoPlant(robot, config.plant)
    plant.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return plant


def close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=TOLERANCE * np.abs(expected).max())


def velocity_map(q):
    """T with v_mujoco = T v_pinocchio: only the base's linear velocity is turned."""
    T = np.eye(len(q) - 1)
    T[:3, :3] = world_from_base(q)
    return T


def convective(q, v):
    """R (ω × v), what the base's linear acceleration gains by being seen from the world."""
    return world_from_base(q) @ np.cross(v[3:6], v[:3])


def mujoco_inertia(plant):
    M = np.zeros((plant.model.nv, plant.model.nv))
    mujoco.mj_fullM(plant.model, plant.data, M)
    return M


def test_inertia_matrices_agree(in_the_air, robot, states):
    data = robot.model.createData()
    for q, v in states:
        in_the_air.set_state(q, v)
        T = velocity_map(q)
        close(T.T @ mujoco_inertia(in_the_air) @ T, pin.crba(robot.model, data, q))


def test_bias_forces_agree(in_the_air, robot, states):
    data = robot.model.createData()
    for q, v in states:
        in_the_air.set_state(q, v)
        a = np.zeros(robot.model.nv)
        a[:3] = convective(q, v)
        h = velocity_map(q).T @ (in_the_air.data.qfrc_bias + mujoco_inertia(in_the_air) @ a)
        close(h, pin.nonLinearEffects(robot.model, data, q, v))


def test_accelerations_under_random_torques_agree(in_the_air, robot, states, rng):
    data = robot.model.createData()
    for q, v in states:
        tau = 20.0 * rng.standard_normal(robot.model.nv - 6)
        in_the_air.set_state(q, v)
        in_the_air.data.ctrl[:] = tau
        mujoco.mj_forward(in_the_air.model, in_the_air.data)
        a = in_the_air.data.qacc.copy()
        a[:3] = world_from_base(q).T @ (a[:3] - convective(q, v))
        close(a, pin.aba(robot.model, data, q, v, np.concatenate([np.zeros(6), tau])))


def test_a_push_accelerates_the_base_body_at_its_centre_of_mass(in_the_air, robot, states):
    data = robot.model.createData()
    push = np.array([3.0, -80.0, 40.0])
    for q, v in states[:20]:
        in_the_air.set_state(q, v)
        in_the_air.data.xfrc_applied[in_the_air.model.body(robot.model.names[1]).id, :3] = push
        mujoco.mj_forward(in_the_air.model, in_the_air.data)
        a = in_the_air.data.qacc.copy()
        a[:3] = world_from_base(q).T @ (a[:3] - convective(q, v))
        force = np.zeros(robot.model.nv)
        force[:3] = world_from_base(q).T @ push
        force[3:6] = np.cross(robot.model.inertias[1].lever, force[:3])
        close(a, pin.aba(robot.model, data, q, v, force))


def test_soles_of_both_models_are_at_the_same_place(plant, robot, model, states):
    for q, v in states[:20]:
        plant.set_state(q, v)
        for foot in robot.soles:
            placement = model.sole_placements(q)[foot.side]
            geom = plant.data.geom(f"{foot.side.value}_sole")
            bottom = geom.xpos - plant.model.geom(geom.id).size[2] * geom.xmat.reshape(3, 3)[:, 2]
            centre = placement.act(foot.corners().mean(axis=0))
            np.testing.assert_allclose(bottom, centre, atol=1e-12)
            np.testing.assert_allclose(geom.xmat.reshape(3, 3), placement.rotation, atol=1e-12)


def test_states_come_back_as_they_went_in(states):
    for q, v in states:
        q_back, v_back = from_mujoco(*to_mujoco(q, v))
        np.testing.assert_array_equal(q_back, q)
        np.testing.assert_allclose(v_back, v, atol=1e-14)


def test_the_other_way_round_too(rng):
    qpos, qvel = rng.standard_normal(38), rng.standard_normal(37)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos_back, qvel_back = to_mujoco(*from_mujoco(qpos, qvel))
    np.testing.assert_array_equal(qpos_back, qpos)
    np.testing.assert_allclose(qvel_back, qvel, atol=1e-14)


def test_conversions_leave_their_input_alone(states):
    q, v = states[3]
    before = q.copy(), v.copy()
    to_mujoco(q, v)
    from_mujoco(q, v)
    np.testing.assert_array_equal(q, before[0])
    np.testing.assert_array_equal(v, before[1])


def test_the_quaternion_goes_from_scalar_last_to_scalar_first():
    q = np.zeros(38)
    q[3:7] = [0.1, 0.2, 0.3, 0.9]
    np.testing.assert_array_equal(to_mujoco(q, np.zeros(37))[0][3:7], [0.9, 0.1, 0.2, 0.3])


def test_a_base_moving_forward_in_its_own_frame_moves_along_its_heading_in_the_world():
    q, v = np.zeros(38), np.zeros(37)
    q[3:7] = pin.Quaternion(pin.utils.rotate("z", np.pi / 2)).coeffs()
    v[0], v[5] = 1.0, 0.3
    qvel = to_mujoco(q, v)[1]
    np.testing.assert_allclose(qvel[:6], [0.0, 1.0, 0.0, 0.0, 0.0, 0.3], atol=1e-15)


def test_the_state_set_is_the_state_read(plant, robot, rng):
    q, v = random_state(robot, spread=0.3, rng=rng)
    plant.set_state(q, v)
    q_read, v_read = plant.state()
    np.testing.assert_allclose(q_read, q, atol=1e-15)
    np.testing.assert_allclose(v_read, v, atol=1e-14)


def test_one_step_integrates_the_accelerations(in_the_air, robot, model, states):
    dt = in_the_air.model.opt.timestep
    q, v = states[1]
    in_the_air.set_state(q, v)
    in_the_air.step(np.zeros(robot.model.nv - 6), push=np.zeros(3))
    q_next, v_next = in_the_air.state()
    a = pin.aba(robot.model, robot.model.createData(), q, v, np.zeros(robot.model.nv))
    # Semi-implicit Euler against the continuous flow: an error of the order of dt.
    np.testing.assert_allclose(v_next - v, dt * a, atol=0.02 * dt * np.abs(a).max())
    np.testing.assert_allclose(
        pin.difference(robot.model, q, q_next), dt * v_next, atol=1e-3 * dt * np.abs(v_next).max()
    )


def test_a_push_lasts_for_one_step_only(in_the_air, robot, model):
    in_the_air.set_state(robot.q_standing, np.zeros(robot.model.nv))
    momenta = []
    for push in (50.0, 0.0, 0.0, -20.0):
        in_the_air.step(np.zeros(robot.model.nv - 6), push=np.array([0.0, push, 0.0]))
        momenta.append(robot.mass * model.kinematics(*in_the_air.state()).com_velocity[1])
    # Momentum is the force's integral: 50 N for 1 ms, then nothing, then −20 N. Limbs that begin to
    # move make the integrator's error of 1e-3.
    np.testing.assert_allclose(momenta, [0.05, 0.05, 0.05, 0.03], rtol=1e-2)


def test_a_robot_at_rest_on_the_floor_carries_its_weight(robot, config, model, reference, stacks):
    plant = MujocoPlant(robot, config.plant)
    stack = stacks[ContactMode.DOUBLE_SUPPORT]
    for _ in range(200):
        q, v = plant.state()
        b = stack.right_hand_side(model.kinematics(q, v), reference)
        solution = solve(stack, stack.matrices(model.jacobians(q)), b, solver=DaqpSolver())
        tau = recover_torque(model, stack.contacts, q, v, solution.projector.apply(b))
        plant.step(tau, push=np.zeros(3))
    weight = robot.mass * 9.81
    force, total = np.zeros(6), 0.0
    for k in range(plant.data.ncon):
        mujoco.mj_contactForce(plant.model, plant.data, k, force)
        total += force[0]
    assert total == pytest.approx(weight, rel=0.02)
    # Soft contacts sink by a fraction of a millimetre.
    assert model.sole_placements(plant.state()[0])[stack.support_foot].translation[2] == (
        pytest.approx(0.0, abs=1e-3)
    )


def test_a_diverged_simulation_is_not_put_back_to_its_start(robot, config):
    plant = MujocoPlant(robot, config.plant)
    v = np.zeros(robot.model.nv)
    v[6:] = 1e12
    plant.set_state(robot.q_standing, v)
    for _ in range(5):
        plant.step(np.zeros(robot.model.nv - 6), push=np.zeros(3))
    # Put back, it would be at rest.
    assert not np.abs(plant.state()[1]).max() < 1e3
