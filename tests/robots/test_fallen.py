"""The rule of a fall: the height of the CoM and the tilt of the base."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.robots.fallen import FALLEN_COM_HEIGHT, FALLEN_TILT, has_fallen

HEIGHT = 0.66


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
