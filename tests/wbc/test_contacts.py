from __future__ import annotations

import numpy as np
import pytest

from shared.robots import Foot
from shared.wbc.contacts import CORNER_MARGIN, ContactMode, contact_geometry

FRICTION, LEAST = 0.5, 1.0


@pytest.fixture(params=list(ContactMode), ids=lambda mode: mode.name)
def geometry(request, robot):
    return contact_geometry(robot, request.param, friction=FRICTION, min_normal_force=LEAST)


def test_the_modes_travel_as_the_numbers_of_the_wire_format():
    assert [(mode.name, mode.value) for mode in ContactMode] == [
        ("DOUBLE_SUPPORT", 0),
        ("LEFT_SUPPORT", 1),
        ("RIGHT_SUPPORT", 2),
    ]


def test_each_mode_loads_the_feet_of_its_name():
    assert ContactMode.DOUBLE_SUPPORT.feet == (Foot.LEFT, Foot.RIGHT)
    assert ContactMode.LEFT_SUPPORT.feet == (Foot.LEFT,)
    assert ContactMode.RIGHT_SUPPORT.feet == (Foot.RIGHT,)


def test_sizes_are_twelve_forces_and_twenty_rows_per_foot(geometry):
    n_feet = len(geometry.mode.feet)
    assert geometry.n_forces == 12 * n_feet
    assert geometry.C.shape == (20 * n_feet, 12 * n_feet)
    assert geometry.l.shape == (20 * n_feet,)
    assert all(geometry.wrench_map[foot].shape == (6, 12) for foot in geometry.mode.feet)


def test_wrench_is_the_sum_of_the_point_forces_and_of_their_moments(geometry, robot, rng):
    f = rng.standard_normal(geometry.n_forces)
    feet = {foot.side: foot for foot in robot.soles}
    wrenches = geometry.wrenches(f)
    assert tuple(wrenches) == geometry.mode.feet
    for k, side in enumerate(geometry.mode.feet):
        forces = f.reshape(-1, 4, 3)[k]
        points = feet[side].corners(CORNER_MARGIN)
        np.testing.assert_allclose(wrenches[side][:3], forces.sum(axis=0), rtol=1e-12)
        moment = np.cross(points, forces).sum(axis=0)
        np.testing.assert_allclose(wrenches[side][3:], moment, rtol=1e-12, atol=1e-14)


def test_pushing_up_at_the_front_tips_the_foot_back(geometry, robot):
    # A vertical force ahead of the sole's origin has a moment about −y: the sign of the maps.
    side = geometry.mode.feet[0]
    points = robot.soles[0].corners(CORNER_MARGIN)
    f = np.zeros(geometry.n_forces)
    front = int(np.argmax(points[:, 0]))
    f[3 * front + 2] = 10.0
    assert geometry.wrenches(f)[side][4] == pytest.approx(-10.0 * points[front, 0])


@pytest.mark.parametrize(
    ("force", "allowed"),
    [
        ((0.0, 0.0, 10.0), True),
        ((4.9, 0.0, 10.0), True),
        ((-4.9, 0.0, 10.0), True),
        ((0.0, 4.9, 10.0), True),
        ((0.0, -4.9, 10.0), True),
        ((4.9, -4.9, 10.0), True),
        ((5.1, 0.0, 10.0), False),
        ((-5.1, 0.0, 10.0), False),
        ((0.0, 5.1, 10.0), False),
        ((0.0, -5.1, 10.0), False),
        ((0.0, 0.0, LEAST - 0.1), False),
        ((0.0, 0.0, -10.0), False),
    ],
)
def test_friction_rows_hold_exactly_inside_the_pyramid(geometry, force, allowed):
    inside = np.tile([0.0, 0.0, 10.0], geometry.n_forces // 3)
    for point in range(geometry.n_forces // 3):
        f = inside.copy()
        f[3 * point : 3 * point + 3] = force
        assert bool(np.all(geometry.C @ f >= geometry.l)) is allowed


def test_a_violated_row_is_one_of_its_point(geometry):
    f = np.tile([0.0, 0.0, 10.0], geometry.n_forces // 3)
    f[3 * 2] = 6.0  # point 2 pulled along +x beyond μ f_z
    violated = np.flatnonzero(geometry.C @ f < geometry.l)
    assert violated.tolist() == [5 * 2 + 1]


def test_a_row_of_an_active_set_has_the_same_bit_in_every_mode():
    # Bit 20 k + i is row i of foot k, left before right.
    rows = np.array([0, 4, 19])
    left = 1 << 0 | 1 << 4 | 1 << 19
    assert ContactMode.LEFT_SUPPORT.active_set(rows) == left
    assert ContactMode.DOUBLE_SUPPORT.active_set(rows) == left
    assert ContactMode.RIGHT_SUPPORT.active_set(rows) == left << 20
    assert ContactMode.DOUBLE_SUPPORT.active_set(rows + 20) == left << 20
    for mode in ContactMode:
        assert mode.active_set(np.empty(0, dtype=int)) == 0
