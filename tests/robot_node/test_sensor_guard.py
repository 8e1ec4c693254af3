"""A robot whose sensors fail for a moment, or for good."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from robot_node.sensor_guard import HELD_OVER_TICKS, SensorGuard
from robot_node.sensors import Sensors
from shared.config.robot_settings import SensorConfig
from shared.motion.plan import make_motion
from shared.motion.plan_frame import PlanFrame
from shared.telemetry.schema import Source
from tests.robot_node.bench import Bench

MS = 1_000_000
KNEE = 9  # of q: the left knee
NAN = float("nan")


@pytest.fixture
def guard(robot):
    return SensorGuard(robot, SensorConfig(joint_position_noise=0.0), period_ns=MS)


def moving(robot, ticks, *, rate=2.0):
    """A robot whose joints and base all move."""
    q, v = robot.q_standing.copy(), np.zeros(robot.model.nv)
    v[6:], v[0] = rate, 1.0
    for _ in range(ticks):
        q = q.copy()
        q[7:] += 1e-3 * rate
        q[0] += 1e-3
        yield q, v


def test_a_motion_passes_unchanged(guard, robot):
    for q, v in moving(robot, 100, rate=20.0):
        checked = guard.check(q, v)
        assert checked[0] is q
        assert checked[1] is v
    assert not guard.faults


@pytest.mark.parametrize("value", [50.0, -50.0, 0.5, NAN, float("inf")])
def test_one_wrong_sample_of_a_joint_is_held_over_and_counted(guard, robot, value):
    for tick, (q, v) in enumerate(moving(robot, 60)):
        measured = q.copy()
        if tick == 30:
            measured[KNEE] += value
        checked, _ = guard.check(measured, v)
        np.testing.assert_allclose(checked, q, atol=1e-12)
    assert guard.faults == {robot.model.names[KNEE - 5]: 1}


def test_a_wrong_speed_is_a_fault_of_its_joint(guard, robot):
    for tick, (q, v) in enumerate(moving(robot, 60)):
        measured = v.copy()
        if tick == 30:
            measured[KNEE - 1] = 1e5
        checked = guard.check(q, measured)
        np.testing.assert_allclose(checked[1], v)
        np.testing.assert_allclose(checked[0], q, atol=1e-12)
    assert guard.faults.total() == 1


@pytest.mark.parametrize("place", [0, 2, 4, 6])
@pytest.mark.parametrize("value", [10.0, NAN])
def test_one_wrong_sample_of_the_base_is_held_over(guard, robot, place, value):
    for tick, (q, v) in enumerate(moving(robot, 60)):
        measured = q.copy()
        if tick == 30:
            measured[place] += value
        checked, _ = guard.check(measured, v)
        # The base is held where it was, a millimetre behind.
        np.testing.assert_allclose(checked, q, atol=2e-3)
    assert guard.faults == {"base": 1}


@pytest.mark.parametrize("value", [0.7, NAN])
def test_a_lasting_fault_is_passed_on_after_a_bounded_time(guard, robot, value):
    passed = []
    for tick, (q, v) in enumerate(moving(robot, 200)):
        measured = q.copy()
        if 30 <= tick < 150:
            measured[KNEE] += value
        checked, _ = guard.check(measured, v)
        passed.append(not np.isclose(checked[KNEE], q[KNEE], atol=1e-9))
    assert not any(passed[: 30 + HELD_OVER_TICKS])
    assert all(passed[30 + HELD_OVER_TICKS : 150])
    # A sensor that comes back is believed at once, or after it has been compared as long.
    assert not any(passed[150 + HELD_OVER_TICKS :])


@pytest.mark.parametrize(
    ("place", "speed"), [(KNEE, False), (KNEE - 1, True), (2, False), (3, False), (0, True)]
)
def test_a_value_that_no_robot_can_have_is_passed_on_as_nan(guard, robot, place, speed):
    passed = []
    for tick, (q, v) in enumerate(moving(robot, 200)):
        q, v = q.copy(), v.copy()
        if 30 <= tick < 150:
            (v if speed else q)[place] = 1e6
        checked, _ = guard.check(q, v)
        assert np.nanmax(np.abs(checked)) < 1e3
        passed.append(bool(np.isnan(checked).any()))
    assert passed == [30 + HELD_OVER_TICKS <= tick < 150 for tick in range(200)]


# Jumps of the base's estimate: displacement [m] and turn about the vertical [rad].
JUMPS = [PlanFrame(x=0.03), PlanFrame(y=-1.0), PlanFrame(z=0.3), PlanFrame(yaw=0.1)]
JUMPS += [PlanFrame(100.0, -50.0, 3.0, -0.2)]


@pytest.mark.parametrize("jump", JUMPS)
def test_a_base_that_jumps_and_stays_there_is_where_it_was(guard, robot, jump):
    for tick, (q, v) in enumerate(moving(robot, 400)):
        measured = jump.in_world(q) if 30 <= tick < 200 else q
        checked, _ = guard.check(measured, v)
        np.testing.assert_allclose(checked, q, atol=1e-9)
    # There and back again.
    assert guard.base_jumps == 2
    assert guard.faults == {"base": 2 * HELD_OVER_TICKS}


def test_a_base_that_jumps_for_a_moment_is_measured_as_before(guard, robot):
    for tick, (q, v) in enumerate(moving(robot, 200)):
        measured = PlanFrame(1.0, 2.0, 3.0).in_world(q) if 30 <= tick < 80 else q
        checked, _ = guard.check(measured, v)
        np.testing.assert_allclose(checked, q, atol=1e-9)
    assert checked is measured
    assert guard.base_jumps == 0


@pytest.mark.parametrize("pause", [10, 60, 200])
def test_an_estimate_that_begins_anew_elsewhere_is_no_motion(guard, robot, pause):
    for tick, (q, v) in enumerate(moving(robot, 500)):
        measured = PlanFrame(0.0, 1.0, -2.0).in_world(q) if tick >= 30 else q.copy()
        if 30 <= tick < 30 + pause:
            measured[:7] = NAN
        checked, _ = guard.check(measured, v)
    # It is where it was when it was known last, at least.
    np.testing.assert_allclose(checked, q, atol=0.2 if pause > HELD_OVER_TICKS else 1e-9)
    assert guard.base_jumps == 1


def test_a_base_that_is_unknown_at_first_is_where_it_is_measured(guard, robot):
    for tick, (q, v) in enumerate(moving(robot, 200)):
        measured = q.copy()
        if tick < 100:
            measured[0] = NAN
        checked, _ = guard.check(measured, v)
    assert checked is measured
    assert guard.base_jumps == 0


@pytest.mark.parametrize("pause", [60, 200])
def test_an_estimate_that_comes_back_is_measured_as_before(guard, robot, pause):
    for tick, (q, v) in enumerate(moving(robot, 300)):
        measured = q.copy()
        if 30 <= tick < 30 + pause:
            measured[:7] = NAN
        checked, _ = guard.check(measured, v)
    assert checked is measured
    assert guard.base_jumps == 0


def test_a_base_that_tilts_by_a_jump_is_passed_on(guard, robot):
    """Gravity says which way is up: no frame explains the jump."""
    tilted = pin.Quaternion(pin.exp3(np.array([0.0, 0.2, 0.0])))
    for tick, (q, v) in enumerate(moving(robot, 200)):
        measured = q.copy()
        if tick >= 30:
            measured[3:7] = (tilted * pin.Quaternion(q[3:7])).coeffs()
        checked, _ = guard.check(measured, v)
        held = 30 <= tick < 30 + HELD_OVER_TICKS
        np.testing.assert_allclose(checked, q if held else measured, atol=1e-9)
    assert guard.base_jumps == 0


NOISY = [SensorConfig(base_position_noise=0.02), SensorConfig(base_position_drift=0.02)]
NOISY += [SensorConfig(tilt_noise=0.02)]


@pytest.mark.parametrize("config", NOISY)
def test_noise_of_the_base_is_no_fault(robot, config):
    guard, sensors = SensorGuard(robot, config, period_ns=MS), Sensors(config, seed=1)
    for q, v in moving(robot, 3000):
        guard.check(*sensors.measure(q, v))
    assert not guard.faults


def test_a_fault_that_comes_back_is_held_over_again(guard, robot):
    for tick, (q, v) in enumerate(moving(robot, 400)):
        measured = q.copy()
        if tick % 10 == 5:
            measured[KNEE] += 3.0
        checked, _ = guard.check(measured, v)
        np.testing.assert_allclose(checked, q, atol=1e-9)
    assert guard.faults.total() == 40


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2, 3e-2, 0.1])
def test_noise_is_no_fault(robot, rng, noise):
    guard = SensorGuard(robot, SensorConfig(joint_position_noise=noise), period_ns=MS)
    for q, v in moving(robot, 3000):
        measured = q.copy()
        measured[7:] += noise * rng.standard_normal(len(q) - 7)
        guard.check(measured, v)
    assert not guard.faults


class Faulty:
    """Sensors that give a wrong sample now and then."""

    def __init__(self, sensors, faults):
        self._sensors, self._faults, self._tick = sensors, faults, 0

    def restart(self):
        self._sensors.restart()

    def forces(self, forces):
        return self._sensors.forces(forces)

    def measure(self, q, v):
        q, v = self._sensors.measure(q, v)
        self._tick += 1
        for place, value in self._faults.get(self._tick, ()):
            q[place] += value
        return q, v


@pytest.mark.parametrize("controller", ["la", "lc", "pr"])
def test_a_glitch_of_an_encoder_hardly_moves_a_robot(
    robot, motion, configured, monkeypatch, controller
):
    glitches = {
        100: [(KNEE, 50.0)],
        120: [(KNEE, NAN), (12, -7.0)],
        140: [(k, 50.0) for k in range(7, 38)],
        160: [(0, 5.0)],
    }
    played = []
    for faults in ({}, glitches):
        bench = Bench(robot, motion, configured(push=[], controller=controller))
        monkeypatch.setattr(bench.robot, "_sensors", Faulty(bench.robot._sensors, faults))
        played.append(bench.run(400))
    clean, faulty = played
    assert faulty.robot.sensor_guard.faults.total() == 1 + 2 + 31 + 1
    assert not faulty.robot.fallen
    # Each held-over sample lacks the noise of the true one, which is all that differs.
    difference = np.abs(faulty.column("q") - clean.column("q")).max()
    assert difference < 0.02
    assert not faulty.edge.refused


STEPPING = {
    "stepping.mode": "on",
    "wbc.balance.law": "dcm",
    "wbc.weights.com": 10.0,
    "correction.refresh_distance": 0.1,
}


@pytest.mark.parametrize("settings", [{"controller": "la"}, {"controller": "lc", **STEPPING}])
@pytest.mark.parametrize("value", [NAN, 1e6])
def test_after_a_lasting_fault_the_robot_goes_on_from_what_it_knew(
    robot, configured, monkeypatch, settings, value
):
    """No average keeps the fault: the plan's place, the feet, the external force, the posture."""
    config = configured(push=[], **settings)
    bench = Bench(robot, make_motion(robot, config), config)
    # Longer than the guard holds over and the plan's anchor waits.
    faults = {tick: [(KNEE, value)] for tick in range(100, 270)}
    monkeypatch.setattr(bench.robot, "_sensors", Faulty(bench.robot._sensors, faults))
    bench.run(400)
    assert not bench.robot.fallen
    sources = [command.source for command in bench.commands]
    assert sources[100:270].count(Source.HELD) == 170 - HELD_OVER_TICKS
    assert Source.HELD not in sources[270:]
    assert np.isfinite(bench.column("q")).all()
    assert math.hypot(bench.robot._plan_frame.x, bench.robot._plan_frame.y) < 0.01
