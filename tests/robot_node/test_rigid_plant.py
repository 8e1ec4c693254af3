"""The robot on ideal rigid contacts obeys Eq. (1), and its soles stay where they are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from robot_node.plant import MujocoPlant
from robot_node.rigid_plant import RigidPlant
from shared.robots import Foot
from shared.robots.fallen import has_fallen
from shared.wbc.contacts import ContactMode
from shared.wbc.projector import solve
from shared.wbc.qp import DaqpSolver
from shared.wbc.torque import recover_torque
from tests.robot_node.bench import Bench
from tests.states import random_state

NO_PUSH = np.zeros(3)


@pytest.fixture
def plant(robot):
    return RigidPlant(robot)


def still_feet(model, q, v):
    """v less what moves the soles, least squares."""
    J = np.vstack([model.jacobians(q).J_sole[foot] for foot in Foot])
    return v - np.linalg.pinv(J) @ (J @ v)


def kkt_acceleration(robot, model, q, v, force):
    """a of Eq. (1) for a generalised force (nv,), from its matrix in M and J_c."""
    data = robot.model.createData()
    M = pin.crba(robot.model, data, q)
    M = np.triu(M) + np.triu(M, 1).T
    J_c = np.vstack([model.jacobians(q).J_sole[foot] for foot in Foot])
    drift = model.kinematics(q, v).sole_acceleration
    h = pin.nonLinearEffects(robot.model, data, q, v)
    K = np.block([[M, -J_c.T], [J_c, np.zeros((12, 12))]])
    rhs = np.concatenate([force - h, *(-drift[foot] for foot in Foot)])
    return np.linalg.solve(K, rhs)[: model.nv]


def moved(model, before, q):
    """The furthest that a sole went or turned since it was at `before` [m, rad]."""
    after = model.sole_placements(q)
    return max(np.abs(pin.log6(before[foot].actInv(after[foot])).vector).max() for foot in Foot)


def balancing_torque(model, stack, reference, q, v):
    """τ of the full QP at the very state."""
    b = stack.right_hand_side(model.kinematics(q, v), reference)
    solution = solve(stack, stack.matrices(model.jacobians(q)), b, solver=DaqpSolver())
    return recover_torque(model, stack.contacts, q, v, solution.projector.apply(b))


def test_accelerations_are_those_of_the_equations_of_motion_in_rigid_contact(
    plant, robot, model, states, rng
):
    for q, v in states:
        v = still_feet(model, q, v)
        plant.set_state(q, v)
        tau, push = 20.0 * rng.standard_normal(31), 50.0 * rng.standard_normal(3)
        force = np.concatenate([np.zeros(6), tau])
        force[:3] = pin.Quaternion(q[3:7]).toRotationMatrix().T @ push
        force[3:6] = np.cross(robot.model.inertias[1].lever, force[:3])
        a = plant.acceleration(tau, push=push)
        expected = kkt_acceleration(robot, model, q, v, force)
        # Measured: 2e-11; 12 dependent rows at a stretched leg would cost digits, not the result.
        np.testing.assert_allclose(a, expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


def test_a_push_acts_as_on_mujocos_robot(robot, config, model, reference, stacks):
    """One millisecond: contacts that give way have not moved yet, those that do not, never."""
    stack = stacks[ContactMode.DOUBLE_SUPPORT]
    momenta = []
    for plant in (RigidPlant(robot), MujocoPlant(robot, config.plant)):
        q, v = plant.state()
        tau = balancing_torque(model, stack, reference, q, v)
        com = []
        for push in (NO_PUSH, np.array([0.0, 80.0, 0.0])):
            plant.set_state(q, v)
            for _ in range(20):
                plant.step(tau, push=push)
            com.append(model.kinematics(*plant.state()).com_velocity)
        momenta.append(robot.mass * (com[1] - com[0]))
    np.testing.assert_allclose(momenta[0], momenta[1], atol=0.15 * np.abs(momenta[1]).max())


def test_soles_stay_where_they_are_for_five_seconds_of_random_torques(
    plant, robot, model, stacks, reference, rng
):
    q, v = plant.state()
    before = model.sole_placements(q)
    carrying = balancing_torque(model, stacks[ContactMode.DOUBLE_SUPPORT], reference, q, v)
    # Springs and dampers on every joint; the twelve of the legs carry all the others.
    inertia = np.diag(pin.crba(robot.model, robot.model.createData(), q))[6:]
    stiffness, damping = 400.0 * inertia, 40.0 * inertia
    stiffness[:12], damping[:12] = 1000.0, 15.0
    travelled = 0.0
    for _ in range(5000):
        q, v = plant.state()
        spring = stiffness * (robot.q_standing[7:] - q[7:]) - damping * v[6:]
        tau = carrying + spring + 0.2 * robot.effort_limit * rng.uniform(-1.0, 1.0, 31)
        plant.step(tau, push=50.0 * rng.standard_normal(3))
        travelled += 1e-3 * np.abs(v[6:]).mean()
        assert moved(model, before, plant.state()[0]) < 1e-6
    assert travelled > 1.0


def test_a_sole_that_was_set_moving_comes_to_rest(plant, robot, model, rng):
    q, v = random_state(robot, spread=0.1, rng=rng)
    plant.set_state(q, v)
    for _ in range(100):
        plant.step(np.zeros(31), push=NO_PUSH)
    velocities = model.kinematics(*plant.state()).sole_velocity
    # Ten time constants; what is left is what the motion of the legs makes of one timestep.
    assert max(np.abs(velocity).max() for velocity in velocities.values()) < 1e-2


def test_contacts_do_no_work(plant, robot):
    """Without torques a robot that folds up on its feet keeps the energy it had."""
    data = robot.model.createData()
    standing = pin.computePotentialEnergy(robot.model, data, robot.q_standing)
    for _ in range(150):
        plant.step(np.zeros(31), push=NO_PUSH)
    q, v = plant.state()
    kinetic = pin.computeKineticEnergy(robot.model, data, q, v)
    assert kinetic > 10.0
    # Semi-implicit Euler errs by the order of what is exchanged within one of 150 timesteps.
    total = kinetic + pin.computePotentialEnergy(robot.model, data, q)
    assert total == pytest.approx(standing, abs=0.02 * kinetic)


def test_a_free_fall_is_impossible(plant, robot, model):
    """Lifted off the floor the soles are welded where they are: the robot hangs on them."""
    q = robot.q_standing.copy()
    q[2] += 0.5
    plant.set_state(q, np.zeros(37))
    before = model.sole_placements(q)
    for _ in range(300):
        plant.step(np.zeros(31), push=NO_PUSH)
    assert moved(model, before, plant.state()[0]) < 1e-3


def test_a_robot_without_torques_folds_up_and_that_is_a_fall(plant, robot, model):
    standing = model.com_and_soles(robot.q_standing)[0][2]
    fallen = False
    for _ in range(1000):
        plant.step(np.zeros(31), push=NO_PUSH)
        q, _ = plant.state()
        fallen = has_fallen(
            q, com_height=model.com_and_soles(q)[0][2], standing_com_height=standing
        )
        if fallen:
            break
    assert fallen


def test_the_state_set_is_the_state_read_and_neither_is_shared(plant, robot, rng):
    q, v = random_state(robot, spread=0.3, rng=rng)
    q_set, v_set = q.copy(), v.copy()
    plant.set_state(q_set, v_set)
    for given, read in zip((q_set, v_set), plant.state(), strict=True):
        given[:] = np.nan
        read[:] = np.nan
    np.testing.assert_array_equal(plant.state()[0], q)
    np.testing.assert_array_equal(plant.state()[1], v)


def test_a_state_that_is_not_finite_stays_so_and_raises_nothing(plant, robot):
    v = np.zeros(37)
    v[10] = np.nan
    plant.set_state(robot.q_standing, v)
    plant.step(np.zeros(31), push=NO_PUSH)
    assert not np.isfinite(plant.state()[0]).all()


def test_torques_beyond_all_measure_raise_nothing(plant):
    for _ in range(50):
        plant.step(np.full(31, 1e12), push=NO_PUSH)
    assert not np.abs(plant.state()[1]).max() < 1e3


def test_a_robot_balances_on_it_as_on_mujoco(robot, motion, configured):
    traces = {}
    for kind in ("rigid", "mujoco"):
        config = configured(
            **{"plant.kind": kind, "push": ["60N@0.05s:0.1s:+y"], "link.network": "direct"}
        )
        played = Bench(robot, motion, config).run(300)
        assert not played.robot.fallen
        traces[kind] = played.column("com") - played.column("com_reference")
    furthest = np.abs(traces["mujoco"]).max()
    assert furthest > 5e-3
    # MuJoCo's floor gives way by a part of a millimetre.
    np.testing.assert_allclose(traces["rigid"], traces["mujoco"], atol=0.15 * furthest)
    assert np.abs(traces["rigid"]).max() == pytest.approx(furthest, rel=0.1)
