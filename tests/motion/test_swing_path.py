"""A foot in the air whose goal changes: no jump, and down at the end."""

from __future__ import annotations

import numpy as np
import pytest

from shared.motion.footprint import Footprint
from shared.motion.swing import PEAK_SAMPLES, SwingPath, peak_gains
from shared.robots import Foot

START = Footprint(Foot.LEFT, 0.0, 0.1, 0.0)
GOAL = Footprint(Foot.LEFT, 0.25, 0.12, 0.2)
OTHER = Footprint(Foot.LEFT, 0.1, 0.2, -0.1)


@pytest.fixture
def path():
    return SwingPath.between(START, GOAL, begin=1.0, end=1.3, height=0.05)


def state(path, time):
    each = path.state(time)
    return np.concatenate(
        (each.position, each.velocity, each.acceleration, [each.yaw, each.yaw_rate])
    )


def test_it_leaves_one_footprint_at_rest_and_comes_down_on_the_other(path):
    first, last = path.state(1.0), path.state(1.3)
    assert first.position == pytest.approx([0.0, 0.1, 0.0], abs=1e-12)
    assert first.velocity == pytest.approx(np.zeros(3), abs=1e-12)
    assert last.position == pytest.approx([0.25, 0.12, 0.0], abs=1e-12)
    assert last.velocity == pytest.approx([0.0, 0.0, -0.15], abs=1e-12)
    assert last.yaw == pytest.approx(0.2)
    heights = [path.state(time).position[2] for time in np.linspace(1.0, 1.3, 61)]
    assert max(heights) == pytest.approx(0.05, abs=1e-3)
    assert min(heights) > -1e-9


@pytest.mark.parametrize("time", [1.02, 1.1, 1.134, 1.2, 1.25])
@pytest.mark.parametrize("end", [1.3, 1.4])
def test_a_new_goal_changes_neither_position_nor_velocity_nor_acceleration(path, time, end):
    new = path.retargeted(OTHER, time=time, end=end, height=0.05)
    assert state(new, time) == pytest.approx(state(path, time), abs=1e-9)
    assert new.state(end).position == pytest.approx([0.1, 0.2, 0.0], abs=1e-9)


def test_a_foot_that_meets_no_ground_goes_on_down(path):
    late = path.state(1.4)
    assert late.position == pytest.approx([0.25, 0.12, -0.015], abs=1e-9)
    assert late.velocity == pytest.approx([0.0, 0.0, -0.15], abs=1e-9)


def test_the_gains_of_the_peak_are_the_acceleration_of_the_quintic(path):
    middle = path.state(1.1)
    new = path.retargeted(OTHER, time=1.1, end=1.35, height=0.05)
    of_distance, of_velocity, of_acceleration = peak_gains()
    T, D = 0.25, OTHER.x - middle.position[0]
    for k, s in enumerate(PEAK_SAMPLES):
        expected = (
            of_distance[k] * D / T**2
            + of_velocity[k] * middle.velocity[0] / T
            + of_acceleration[k] * middle.acceleration[0]
        )
        assert new.state(1.1 + s * T).acceleration[0] == pytest.approx(expected, abs=1e-9)
