from __future__ import annotations

import numpy as np
import pytest

from robot_node.sensors import Sensors
from shared.config.config_file import load_config
from shared.config.robot_settings import SensorConfig
from shared.robots import Foot

NOISY = SensorConfig(joint_position_noise=1e-2, joint_velocity_noise=0.1)


def readings(sensors, robot, count=5):
    return [sensors.measure(robot.q_standing, np.zeros(37)) for _ in range(count)]


def with_error(setting, size):
    """Exact sensors but for one error."""
    return load_config(
        None, {f"sensors.{setting}": size, "sensors.joint_position_noise": 0}
    ).sensors


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


def test_the_base_is_exact_unless_an_error_is_asked_for(robot):
    q, v = Sensors(NOISY, seed=0).measure(robot.q_standing, np.ones(37))
    np.testing.assert_array_equal(q[:7], robot.q_standing[:7])
    np.testing.assert_array_equal(v[:6], 1.0)


@pytest.mark.parametrize(
    ("setting", "measured", "size"),
    [
        ("base_position_noise", lambda q, v: q[:3], 0.01),
        ("base_velocity_noise", lambda q, v: v[:3], 0.01),
        ("tilt_noise", lambda q, v: 2.0 * q[3:6], 0.01),
        ("gyro_noise", lambda q, v: v[3:6], 0.01),
    ],
)
def test_noise_of_the_base_has_its_standard_deviation(robot, setting, measured, size):
    sensors = Sensors(with_error(setting, size), seed=0)
    values = np.array([measured(*each) for each in readings(sensors, robot, 2000)])
    exact = measured(robot.q_standing, np.zeros(37))
    np.testing.assert_allclose((values - exact).std(axis=0), size, rtol=0.1)


@pytest.mark.parametrize(
    ("setting", "measured"),
    [("tilt_bias", lambda q, v: 2.0 * q[3:6]), ("gyro_bias", lambda q, v: v[3:6])],
)
def test_a_bias_stays_the_same_in_a_run_and_differs_between_seeds(robot, setting, measured):
    config = with_error(setting, 0.01)
    first, later = (measured(*each) for each in readings(Sensors(config, seed=0), robot, 2))
    np.testing.assert_array_equal(first, later)
    other = measured(*readings(Sensors(config, seed=1), robot, 1)[0])
    assert 0.0 < np.abs(first - other).max() < 0.05


def test_drift_grows_as_a_random_walk(robot):
    config = SensorConfig(base_position_drift=0.1)
    ends = [
        readings(Sensors(config, seed=seed), robot, 250)[-1][0][:3] - robot.q_standing[:3]
        for seed in range(100)
    ]
    # 0.1 m in a second is half of it in a quarter.
    assert np.std(ends) == pytest.approx(0.05, rel=0.2)


def test_errors_of_the_base_leave_the_joints_noise_as_it_is(robot):
    with_base = SensorConfig(joint_position_noise=1e-2, joint_velocity_noise=0.1, gyro_noise=0.1)
    exact, noisy = (readings(Sensors(each, seed=0), robot) for each in (NOISY, with_base))
    for (q, v), (q_noisy, v_noisy) in zip(exact, noisy, strict=True):
        np.testing.assert_array_equal(q[7:], q_noisy[7:])
        np.testing.assert_array_equal(v[6:], v_noisy[6:])


def test_measured_forces_are_the_true_ones_with_noise():
    true = {foot: np.array([1.0, 2.0, 200.0]) for foot in Foot}
    exact = Sensors(SensorConfig(), seed=0).forces(true)
    np.testing.assert_array_equal(exact[Foot.LEFT], true[Foot.LEFT])
    sensors = Sensors(SensorConfig(force_noise=3.0), seed=0)
    noise = np.array([sensors.forces(true)[Foot.RIGHT] for _ in range(1000)]) - true[Foot.RIGHT]
    np.testing.assert_allclose(noise.std(axis=0), 3.0, rtol=0.1)
