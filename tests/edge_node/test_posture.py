from __future__ import annotations

import numpy as np
import pytest

from edge_node.posture import PostureEstimate

MS = 1_000_000
JOINTS = 31


def state(joints, speeds):
    q, v = np.zeros(7 + JOINTS), np.zeros(6 + JOINTS)
    q[7:], v[6:] = joints, speeds
    return q, v


def play(positions, speeds, *, every_ms=1):
    estimate = PostureEstimate(10 * MS)
    for k, (position, speed) in enumerate(zip(positions, speeds, strict=True)):
        estimate.observe(*state(position, speed), stamp_ns=k * every_ms * MS)
    return estimate


def test_the_first_state_is_taken_as_it_is():
    np.testing.assert_array_equal(play([0.3], [1.0]).now, np.full(JOINTS, 0.3))


@pytest.mark.parametrize("every_ms", [1, 7, 40, 200])
def test_steady_motion_makes_no_lag(every_ms):
    times = np.arange(100) * every_ms * 1e-3
    estimate = play(2.0 * times, np.full(100, 2.0), every_ms=every_ms)
    np.testing.assert_allclose(estimate.now, 2.0 * times[-1], atol=1e-12)


def test_noise_is_averaged_out():
    noise = np.random.default_rng(0).normal(scale=0.01, size=(2000, JOINTS))
    estimate = PostureEstimate(10 * MS)
    errors = []
    for k, each in enumerate(noise):
        estimate.observe(*state(0.5 + each, 0.0), stamp_ns=k * MS)
        errors.append(estimate.now - 0.5)
    # An average over 10 ms: the variance of white noise falls by 2 τ / T = 20.
    assert 0.5 * 0.01 / np.sqrt(20) < np.std(errors[100:]) < 1.5 * 0.01 / np.sqrt(20)


@pytest.mark.parametrize("stamp_ns", [100 * MS, -5 * MS])
def test_after_a_gap_or_a_new_start_the_measured_posture_counts_alone(stamp_ns):
    estimate = play([0.3], [1.0])
    estimate.observe(*state(-0.2, 0.0), stamp_ns=stamp_ns)
    np.testing.assert_array_equal(estimate.now, np.full(JOINTS, -0.2))


def test_ahead_is_so_far_along_the_motion():
    estimate = play([0.0], [np.linspace(-2.0, 3.0, JOINTS)])
    moved = estimate.ahead(0.01)
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(0.01)
    np.testing.assert_allclose(np.diff(moved, n=2), 0.0, atol=1e-15)


def test_ahead_of_a_slow_robot_is_no_further_than_its_velocity_can_tell():
    np.testing.assert_allclose(play([0.0], [0.1]).ahead(0.05), 0.1 * 0.05)


def test_ahead_of_a_robot_at_rest_is_where_it_is():
    np.testing.assert_array_equal(play([0.4], [0.0]).ahead(0.05), np.full(JOINTS, 0.4))


@pytest.mark.parametrize("jump", [50.0, -0.6])
def test_a_joint_that_jumps_for_a_moment_is_not_followed(jump):
    clean, glitched = np.full((60, JOINTS), 0.3), np.full((60, JOINTS), 0.3)
    glitched[30, 4] += jump
    glitched[40:43, 4] += jump
    speeds = np.zeros(60)
    np.testing.assert_allclose(play(glitched, speeds).now, play(clean, speeds).now, atol=1e-12)


def test_a_joint_that_has_moved_for_good_is_followed_after_50_ms():
    positions = np.full((120, JOINTS), 0.3)
    positions[30:, 4] = 2.0
    for ticks, expected in ((80, 0.3), (81, 2.0), (120, 2.0)):
        estimate = play(positions[:ticks], np.zeros(ticks))
        np.testing.assert_allclose(estimate.now[4], expected)
        np.testing.assert_allclose(estimate.now[:4], 0.3)
