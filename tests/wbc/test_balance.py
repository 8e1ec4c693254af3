"""The balance law: the support, the CoP it commands, the observer."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shared.config.control_settings import BalanceConfig
from shared.robots import Foot
from shared.wbc.balance import BalanceLaw, convex_hull, within

SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
NO_OBSERVER = BalanceConfig(law="dcm", observer_time=0.0, beyond=10.0)


def test_the_hull_of_points_is_their_corners_counter_clockwise(rng):
    inside = rng.uniform(0.0, 1.0, (40, 2))
    points = np.concatenate([inside, SQUARE, [(0.5, 0.0)]])
    assert convex_hull(rng.permutation(points)) == SQUARE


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((0.5, 0.5), (0.5, 0.5)),
        ((1.05, 0.5), (1.05, 0.5)),
        ((2.0, 0.5), (1.1, 0.5)),
        ((0.5, -3.0), (0.5, -0.1)),
        ((1.0 + 3.0, 1.0 + 4.0), (1.06, 1.08)),
    ],
)
def test_a_point_is_moved_to_the_border_at_most(point, expected):
    np.testing.assert_allclose(within(SQUARE, point, beyond=0.1), expected, atol=1e-12)


def command(robot, model, reference, config, *, v=None, law=None, wrenches=None):
    law = law or BalanceLaw(robot, config, period=1e-3)
    v = np.zeros(37) if v is None else v
    return law.com_command(model.kinematics(robot.q_standing, v), reference, wrenches or {})


def test_at_rest_at_the_reference_nothing_is_asked(robot, model, reference):
    np.testing.assert_allclose(command(robot, model, reference, NO_OBSERVER), 0.0, atol=1e-12)


def test_the_command_is_feedback_of_the_dcm(robot, model, reference):
    v = np.zeros(37)
    v[0] = 0.02
    now = model.kinematics(robot.q_standing, v)
    omega_2 = 9.81 / now.com[2]
    omega = math.sqrt(omega_2)
    expected = -omega_2 * (1.0 + NO_OBSERVER.gain / omega) * now.com_velocity[:2] / omega
    np.testing.assert_allclose(
        command(robot, model, reference, NO_OBSERVER, v=v), expected, rtol=1e-6, atol=1e-9
    )


def test_the_cop_is_commanded_at_most_so_far_beyond_the_support(robot, model, reference):
    v = np.zeros(37)
    v[0] = 5.0
    beyond = BalanceConfig(law="dcm", observer_time=0.0, beyond=0.05)
    asked = command(robot, model, reference, beyond, v=v)
    now = model.kinematics(robot.q_standing, v)
    toes = max(
        now.sole_placement(foot.side).act(corner)[0]
        for foot in robot.soles
        for corner in foot.corners()
    )
    cop = now.com[0] - asked[0] * now.com[2] / 9.81
    assert cop == pytest.approx(toes + 0.05, abs=1e-4)


def test_the_observer_finds_a_constant_force(robot, model, reference):
    """The CoM accelerates by 2 m/s² with no contact force in the plane: F/m = 2 m/s²."""
    config = BalanceConfig(law="dcm", gain=0.0, beyond=10.0, dead_band=0.0)
    law = BalanceLaw(robot, config, period=1e-3)
    wrenches = {Foot.LEFT: np.array([0.0, 0.0, 400.0, 0.0, 0.0, 0.0])}
    without = BalanceLaw(
        robot, BalanceConfig(law="dcm", gain=0.0, beyond=10.0, observer_time=0.0), period=1e-3
    )
    v = np.zeros(37)
    for tick in range(100):
        v[1] = 2e-3 * tick
        asked = command(robot, model, reference, config, v=v, law=law, wrenches=wrenches)
        plain = command(robot, model, reference, config, v=v, law=without)
    # The shift F/(m ω²) of the CoP takes ω² of it from the command.
    np.testing.assert_allclose(asked - plain, [0.0, -2.0], atol=1e-3)


def test_a_small_estimate_is_left_out(robot, model, reference):
    config = BalanceConfig(law="dcm", gain=0.0, beyond=10.0, dead_band=0.06)
    law = BalanceLaw(robot, config, period=1e-3)
    wrenches = {Foot.LEFT: np.array([0.0, 0.0, 400.0, 0.0, 0.0, 0.0])}
    v = np.zeros(37)
    for tick in range(50):
        v[1] = 0.5e-3 * tick
        asked = command(robot, model, reference, config, v=v, law=law, wrenches=wrenches)
    # 0.5 m/s² over ω² of 15 1/s² is 3 cm.
    only_dcm = BalanceConfig(law="dcm", gain=0.0, beyond=10.0, observer_time=0.0)
    np.testing.assert_array_equal(asked, command(robot, model, reference, only_dcm, v=v))


@pytest.mark.parametrize("force", [1e6, -1e6, math.nan])
def test_a_force_that_no_robot_stands_is_soon_forgotten(robot, model, reference, force):
    """The observer of a robot that has fallen: at most its weight, so at most its height."""
    config = BalanceConfig(law="dcm")
    law = BalanceLaw(robot, config, period=1e-3)
    for tick in range(150):
        pull = force if tick == 50 else 0.0
        wrenches = {Foot.LEFT: np.array([pull, 0.0, 400.0, 0.0, 0.0, 0.0])}
        command(robot, model, reference, config, law=law, wrenches=wrenches)
        assert np.hypot(*law.disturbance) <= 1.001 * reference.com[2]
    assert np.hypot(*law._disturbance) < 0.01
