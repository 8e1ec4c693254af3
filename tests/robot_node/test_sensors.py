from __future__ import annotations

import numpy as np
import pytest

from robot_node.sensors import Sensors
from shared.config.settings import SensorConfig

NOISY = SensorConfig(joint_position_noise=1e-2, joint_velocity_noise=0.1)


def readings(sensors, robot, count=5):
    return [sensors.measure(robot.q_standing, np.zeros(37)) for _ in range(count)]


def same(left, right):
    return all(
        np.array_equal(a, b)
        for pair in zip(left, right, strict=True)
        for a, b in zip(*pair, strict=True)
    )


def test_the_same_seed_gives_the_same_noise_and_another_seed_another(robot):
    first = readings(Sensors(NOISY, seed=3), robot)
    assert same(first, readings(Sensors(NOISY, seed=3), robot))
    assert not same(first, readings(Sensors(NOISY, seed=4), robot))


def test_a_restart_begins_the_noise_anew(robot):
    sensors = Sensors(NOISY, seed=3)
    first = readings(sensors, robot)
    readings(sensors, robot, 17)
    sensors.restart()
    assert same(first, readings(sensors, robot))


def test_noise_changes_from_reading_to_reading(robot):
    first, second = readings(Sensors(NOISY, seed=0), robot, 2)
    assert not np.any(np.isclose(first[0][7:], second[0][7:], rtol=0, atol=1e-12))


def test_the_base_is_measured_exactly(robot, states):
    q, v = states[3]
    q_measured, v_measured = Sensors(NOISY, seed=0).measure(q, v)
    np.testing.assert_array_equal(q_measured[:7], q[:7])
    np.testing.assert_array_equal(v_measured[:6], v[:6])


def test_without_noise_the_state_itself_is_measured(robot, states):
    quiet = Sensors(SensorConfig(joint_position_noise=0.0, joint_velocity_noise=0.0), seed=0)
    q, v = states[3]
    q_measured, v_measured = quiet.measure(q, v)
    np.testing.assert_array_equal(q_measured, q)
    np.testing.assert_array_equal(v_measured, v)


def test_the_true_state_is_left_alone(robot):
    q, v = robot.q_standing.copy(), np.zeros(37)
    Sensors(NOISY, seed=0).measure(q, v)
    np.testing.assert_array_equal(q, robot.q_standing)
    np.testing.assert_array_equal(v, 0.0)


@pytest.mark.parametrize(("part", "sigma"), [(0, 1e-2), (1, 0.1)])
def test_noise_has_the_standard_deviation_asked_for(robot, part, sigma):
    many = readings(Sensors(NOISY, seed=0), robot, 1000)
    true = (robot.q_standing[7:], np.zeros(31))[part]
    noise = np.array([reading[part][-31:] for reading in many]) - true
    # 31 000 samples: the standard deviation is known to 0.4 %, the mean to 0.6 % of σ; 4 of those.
    assert noise.std() == pytest.approx(sigma, rel=0.016)
    assert abs(noise.mean()) < 0.024 * sigma


def test_velocity_noise_does_not_change_the_position_noise(robot):
    position_only = SensorConfig(joint_position_noise=1e-2, joint_velocity_noise=0.0)
    both = readings(Sensors(NOISY, seed=3), robot)
    one = readings(Sensors(position_only, seed=3), robot)
    for (q_both, _), (q_one, _) in zip(both, one, strict=True):
        np.testing.assert_array_equal(q_both, q_one)
