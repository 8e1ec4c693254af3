from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from robot_node.safety import JointHold, TorqueGuard, TorqueRateLimiter
from shared.robots import Foot, load_robot


@pytest.fixture
def guard(robot):
    return TorqueGuard(robot, clamp=1.45)


@pytest.fixture
def hold(robot):
    return JointHold(robot, timestep=1e-3)


def test_a_torque_within_the_limits_passes_unchanged(guard, rng):
    tau = guard.limit * rng.uniform(-1.0, 1.0, size=31)
    np.testing.assert_array_equal(guard.accept(tau), tau)


def test_a_torque_beyond_the_limits_is_clamped_joint_by_joint(guard, robot):
    tau = np.zeros(31)
    tau[4], tau[9] = 1e6, -1e6
    safe = guard.accept(tau)
    assert safe[4] == pytest.approx(1.45 * robot.effort_limit[4], rel=1e-15)
    assert safe[9] == pytest.approx(-1.45 * robot.effort_limit[9], rel=1e-15)
    np.testing.assert_array_equal(np.delete(safe, [4, 9]), 0.0)


def test_the_clamp_scales_the_limits(robot):
    np.testing.assert_array_equal(TorqueGuard(robot, clamp=1.0).limit, robot.effort_limit)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("joint", [0, 15, 30])
def test_a_torque_that_is_not_finite_is_refused_whole(guard, value, joint):
    tau = np.ones(31)
    tau[joint] = value
    assert guard.accept(tau) is None


def test_infinities_that_cancel_are_refused(guard):
    tau = np.ones(31)
    tau[:2] = np.inf, -np.inf
    assert guard.accept(tau) is None


def test_the_guard_leaves_its_input_alone(guard):
    tau = np.full(31, 1e6)
    guard.accept(tau)
    np.testing.assert_array_equal(tau, 1e6)


def observed(hold, q, ticks, **where):
    for _ in range(ticks):
        hold.observe(q, **where)
    return hold


STILL = np.zeros(37)
ELSEWHERE = {"feet_as_standing": False}


@pytest.fixture
def bearing(robot):
    """The torques of a hold that pulls nowhere."""
    return JointHold(robot, timestep=1e-3).torque(robot.q_standing, STILL)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_joint_without_a_measurement_does_not_make_the_others_limp(robot, bearing, value):
    hold = JointHold(robot, timestep=1e-3)
    q, v = robot.q_standing.copy(), np.zeros(37)
    q[12], v[20], q[25] = value, -value, q[25] + 0.01
    tau = hold.torque(q, v)
    assert tau[18] != bearing[18]
    np.testing.assert_array_equal(np.delete(tau, 18), np.delete(bearing, 18))


def test_the_torques_of_a_hold_bear_the_standing_robot(robot, model, bearing):
    # With some wrenches on the soles, nothing accelerates: also the base, which has no motor.
    J_sole = model.jacobians(robot.q_standing).J_sole
    J_c = np.concatenate([J_sole[foot] for foot in Foot])
    weight = model.inverse_dynamics(robot.q_standing, STILL, STILL, {}).copy()
    needed = weight - np.concatenate([np.zeros(6), bearing])
    wrenches, *_ = np.linalg.lstsq(J_c.T, needed, rcond=None)
    np.testing.assert_allclose(J_c.T @ wrenches, needed, atol=1e-9)
    # Each foot bears half of the weight.
    assert wrenches[2] == pytest.approx(robot.mass * 9.81 / 2, rel=1e-3)


def test_on_feet_that_stand_elsewhere_the_posture_of_before_is_held(hold, robot, bearing):
    q = robot.q_standing.copy()
    q[7:] += 0.3
    # A second of 1 kHz, twenty time constants of the average: e⁻²⁰ of the difference is left.
    observed(hold, q, 1000, **ELSEWHERE)
    for _ in range(400):
        np.testing.assert_allclose(hold.torque(q, STILL), bearing, atol=1e-5)
    assert not hold.sets_foot_down


def test_a_joint_that_leaves_is_pulled_back_and_braked(hold, robot, bearing):
    q, v = robot.q_standing.copy(), np.zeros(37)
    q[7 + 3] += 0.1
    v[6 + 5] = 1.0
    tau = hold.torque(q, v) - bearing
    assert tau[3] < 0.0
    assert tau[5] < 0.0
    np.testing.assert_array_equal(np.delete(tau, [3, 5]), 0.0)


def test_what_is_held_does_not_move_while_it_is_held(hold, robot, rng):
    observed(hold, robot.q_standing, 1000, **ELSEWHERE)
    before = hold.torque(robot.q_standing, STILL)
    for _ in range(100):
        q = robot.q_standing.copy()
        q[7:] += rng.standard_normal(31)
        hold.torque(q, rng.standard_normal(37))
    np.testing.assert_array_equal(hold.torque(robot.q_standing, STILL), before)


def test_what_is_held_follows_a_new_posture_within_a_tenth_of_a_second(hold, robot, bearing):
    q = robot.q_standing.copy()
    q[7:] += 0.1
    hold.observe(robot.q_standing, **ELSEWHERE)
    start = hold.torque(q, STILL) - bearing
    # A time constant of 50 ms: 1/e of the way is left after 50 ticks, 1/e² after 100.
    for share in (np.exp(-1.0), np.exp(-2.0)):
        left = observed(hold, q, 50, **ELSEWHERE).torque(q, STILL) - bearing
        np.testing.assert_allclose(left, share * start, rtol=0.03)


def test_one_noisy_measurement_is_not_what_is_held(hold, robot, rng, bearing):
    sigma, away = 1e-2, robot.q_standing.copy()
    away[7:] += 1.0
    hold.observe(robot.q_standing, **ELSEWHERE)
    stiffness = bearing - hold.torque(away, STILL)
    for _ in range(500):
        q = robot.q_standing.copy()
        q[7:] += sigma * rng.standard_normal(31)
        hold.observe(q, **ELSEWHERE)
    offset = (hold.torque(robot.q_standing, STILL) - bearing) / stiffness
    # The average lets √(0.02 / 1.98) = 0.1 of σ through; the largest of 31 is below 4 of those.
    assert np.abs(offset).max() < 4 * 0.1 * sigma


def test_what_is_held_does_not_follow_arrays_that_change(hold, robot):
    q = robot.q_standing.copy()
    observed(hold, q, 10, **ELSEWHERE)
    before = hold.torque(robot.q_standing, STILL)
    q[7:] += 1.0
    np.testing.assert_array_equal(hold.torque(robot.q_standing, STILL), before)


@pytest.mark.parametrize("name", ["romeo", "talos"])
def test_no_joint_swings_up_under_the_hold_of_a_robot_in_the_air(name):
    # Before the gains knew the inertia, Romeo's wrist was ten times as fast with every tick, and
    # the chatter of the light joints shook the feet along the floor.
    robot = load_robot(name)
    model = robot.model.copy()
    model.gravity = pin.Motion.Zero()
    data, hold = model.createData(), JointHold(robot, timestep=1e-3)
    for joint in range(model.nv - 6):
        q, v = robot.q_standing.copy(), np.zeros(model.nv)
        v[6 + joint] = 1.0
        for _ in range(20):
            tau = np.concatenate([np.zeros(6), hold.torque(q, v)])
            v = v + 1e-3 * pin.aba(model, data, q, v, tau)
            q = pin.integrate(model, q, 1e-3 * v)
        assert np.abs(v[6:]).max() < 1.0, model.names[2 + joint]


@pytest.mark.parametrize(
    ("where", "ticks"), [({"on_both_feet": False, **ELSEWHERE}, 150), ({}, 300)]
)
def test_joints_move_to_the_standing_posture_where_both_feet_are_down(
    hold, robot, bearing, where, ticks
):
    q = robot.q_standing.copy()
    q[7:] += 0.1
    observed(hold, q, 1000, **where)
    first = hold.torque(q, STILL) - bearing
    for _ in range(ticks - 2):
        hold.torque(q, STILL)
    last = hold.torque(q, STILL) - bearing
    np.testing.assert_allclose(first, last / ticks, rtol=1e-3)
    assert last[3] < -1.0
    np.testing.assert_allclose(hold.torque(robot.q_standing, STILL), bearing, atol=1e-9)


def test_a_hold_sets_a_foot_down_for_a_quarter_of_a_second(hold, robot):
    observed(hold, robot.q_standing, 1, on_both_feet=False)
    shown = []
    for _ in range(260):
        shown.append(hold.sets_foot_down)
        hold.torque(robot.q_standing, STILL)
    assert shown == [False] + 249 * [True] + 10 * [False]
    observed(hold, robot.q_standing, 1)
    hold.torque(robot.q_standing, STILL)
    assert not hold.sets_foot_down


def test_on_one_rung_a_torque_may_jump(guard):
    change = TorqueRateLimiter(guard)
    for sign in (1.0, -1.0, 1.0):
        tau = sign * guard.limit
        np.testing.assert_array_equal(change.bound(tau, changed=False), tau)


def test_the_first_torque_of_all_may_be_any(guard):
    np.testing.assert_array_equal(
        TorqueRateLimiter(guard).bound(guard.limit, changed=True), guard.limit
    )


def test_on_another_rung_each_joint_follows_by_a_tenth_of_its_limit_per_tick(guard):
    change = TorqueRateLimiter(guard)
    change.bound(np.zeros(31), changed=False)
    goal = guard.limit * np.linspace(-0.95, 0.95, 31)
    applied = [change.bound(goal, changed=k == 0) for k in range(12)]
    step = 0.1 * guard.limit
    for k, tau in enumerate(applied):
        expected = np.clip(goal, -(k + 1) * step, (k + 1) * step)
        np.testing.assert_allclose(tau, expected, atol=1e-12)


def test_a_robot_that_has_caught_up_may_jump_again(guard, rng):
    # Commands of either sign, never further from the last than a step.
    change = TorqueRateLimiter(guard)
    for k in range(4):
        tau = 0.04 * guard.limit * rng.uniform(-1.0, 1.0, 31)
        np.testing.assert_allclose(change.bound(tau, changed=k == 1), tau, rtol=1e-12)
    np.testing.assert_array_equal(change.bound(guard.limit, changed=False), guard.limit)


def test_a_robot_that_has_not_caught_up_may_not(guard):
    change = TorqueRateLimiter(guard)
    change.bound(np.zeros(31), changed=False)
    change.bound(0.5 * guard.limit, changed=True)
    tau = change.bound(guard.limit, changed=False)
    np.testing.assert_allclose(tau, 0.2 * guard.limit, rtol=1e-12)
