from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from robot_node.safety import (
    FALLEN_COM_HEIGHT,
    FALLEN_TILT,
    JointHold,
    TorqueGuard,
    TorqueRateLimiter,
    has_fallen,
)
from shared.robots import load_robot

HEIGHT = 0.66


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


def observed(hold, q, tau, ticks):
    for _ in range(ticks):
        hold.observe(q, tau)
    return hold


def test_holding_goes_on_with_the_posture_and_the_torque_of_before(hold, robot, rng):
    q, tau = robot.q_standing.copy(), rng.standard_normal(31)
    q[7:] += 0.3
    # A second of 1 kHz, twenty time constants of the average: e⁻²⁰ of the difference is left.
    observed(hold, q, tau, 1000)
    np.testing.assert_allclose(hold.torque(q, np.zeros(37)), tau, atol=1e-5)


def test_a_robot_that_was_never_controlled_holds_its_standing_posture(hold, robot):
    np.testing.assert_array_equal(hold.torque(robot.q_standing, np.zeros(37)), 0.0)


def test_a_joint_that_leaves_is_pulled_back_and_braked(hold, robot):
    q, v = robot.q_standing.copy(), np.zeros(37)
    q[7 + 3] += 0.1
    v[6 + 5] = 1.0
    tau = hold.torque(q, v)
    assert tau[3] < 0.0
    assert tau[5] < 0.0
    np.testing.assert_array_equal(np.delete(tau, [3, 5]), 0.0)


def test_what_is_held_does_not_move_while_it_is_held(hold, robot, rng):
    observed(hold, robot.q_standing, np.full(31, 2.0), 1000)
    before = hold.torque(robot.q_standing, np.zeros(37))
    for _ in range(100):
        q = robot.q_standing.copy()
        q[7:] += rng.standard_normal(31)
        hold.torque(q, rng.standard_normal(37))
    np.testing.assert_array_equal(hold.torque(robot.q_standing, np.zeros(37)), before)


def test_what_is_held_follows_a_new_posture_within_a_tenth_of_a_second(hold, robot):
    q = robot.q_standing.copy()
    q[7:] += 0.1
    start = hold.torque(q, np.zeros(37))
    # A time constant of 50 ms: 1/e of the way is left after 50 ticks, 1/e² after 100.
    for share in (np.exp(-1.0), np.exp(-2.0)):
        left = observed(hold, q, np.zeros(31), 50).torque(q, np.zeros(37))
        np.testing.assert_allclose(left, share * start, rtol=0.03)


def test_one_noisy_measurement_is_not_what_is_held(hold, robot, rng):
    sigma, away = 1e-2, robot.q_standing.copy()
    away[7:] += 1.0
    stiffness = -hold.torque(away, np.zeros(37))
    for _ in range(500):
        q = robot.q_standing.copy()
        q[7:] += sigma * rng.standard_normal(31)
        hold.observe(q, np.zeros(31))
    offset = hold.torque(robot.q_standing, np.zeros(37)) / stiffness
    # The average lets √(0.02 / 1.98) = 0.1 of σ through; the largest of 31 is below 4 of those.
    assert np.abs(offset).max() < 4 * 0.1 * sigma


def test_what_is_held_does_not_follow_arrays_that_change(hold, robot):
    q, tau = robot.q_standing.copy(), np.full(31, 2.0)
    observed(hold, q, tau, 10)
    before = hold.torque(robot.q_standing, np.zeros(37))
    tau[:] = 50.0
    q[7:] += 1.0
    np.testing.assert_array_equal(hold.torque(robot.q_standing, np.zeros(37)), before)


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


def test_a_hold_that_begins_on_one_foot_moves_to_the_standing_posture(hold, robot):
    q = robot.q_standing.copy()
    q[7:] += 0.1
    for _ in range(1000):
        hold.observe(q, np.zeros(31), on_both_feet=False)
    assert not hold.sets_foot_down
    still = np.zeros(37)
    # Of a tenth of a radian, 1 ms of 150 is asked for at first, and all of it from 150 ms on.
    np.testing.assert_allclose(
        hold.torque(q, still), hold.torque(robot.q_standing, still) / -149.0, rtol=0.02
    )
    for _ in range(148):
        assert hold.sets_foot_down
        hold.torque(q, still)
    np.testing.assert_allclose(hold.torque(robot.q_standing, still), 0.0, atol=1e-9)
    for _ in range(100):
        hold.torque(q, still)
    assert not hold.sets_foot_down


def test_a_hold_on_both_feet_does_not_move_them(hold, robot):
    q = robot.q_standing.copy()
    q[7:] += 0.1
    observed(hold, q, np.zeros(31), 1000)
    for _ in range(300):
        np.testing.assert_allclose(hold.torque(q, np.zeros(37)), 0.0, atol=1e-3)
    assert not hold.sets_foot_down


def tilted(robot, angle, axis):
    step = np.zeros(37)
    step[3 + axis] = angle
    return pin.integrate(robot.model, robot.q_standing, step)


def fallen(q, *, com_height=HEIGHT):
    return has_fallen(q, com_height=com_height, standing_com_height=HEIGHT)


def test_a_standing_robot_has_not_fallen(robot):
    assert not fallen(robot.q_standing)


def test_a_low_centre_of_mass_is_a_fall(robot):
    limit = FALLEN_COM_HEIGHT * HEIGHT
    assert not fallen(robot.q_standing, com_height=limit + 1e-6)
    assert fallen(robot.q_standing, com_height=limit - 1e-6)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_tilted_base_is_a_fall(robot, axis, sign):
    assert not fallen(tilted(robot, sign * (FALLEN_TILT - 1e-3), axis))
    assert fallen(tilted(robot, sign * (FALLEN_TILT + 1e-3), axis))


def test_a_robot_on_its_head_has_fallen(robot):
    assert fallen(tilted(robot, np.pi, 0))


def test_turning_on_the_spot_is_no_fall(robot):
    assert not fallen(tilted(robot, 3.0, 2))


@pytest.mark.parametrize("height", [np.nan, -np.inf])
def test_a_height_that_is_no_number_is_a_fall(robot, height):
    assert fallen(robot.q_standing, com_height=height)


def test_an_orientation_that_is_no_number_is_a_fall(robot):
    q = robot.q_standing.copy()
    q[3:7] = np.nan
    assert fallen(q)


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
