"""A swing foot whose goal changes: no jump, and down at the end."""

from __future__ import annotations

import numpy as np
import pytest

from shared.motion.footprint import Footprint
from shared.motion.swing import PEAK_SAMPLES, SwingPath, peak_gains
from shared.robots import Foot

START = Footprint(Foot.LEFT, 0.0, 0.1, 0.0)
GOAL = Footprint(Foot.LEFT, 0.25, 0.12, 0.2)
OTHER = Footprint(Foot.LEFT, 0.1, 0.2, -0.1)
STAIR = Footprint(Foot.LEFT, 0.3, 0.1, 0.0, 0.06)


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
    new = path.retargeted(OTHER, time=time, end=end)
    assert state(new, time) == pytest.approx(state(path, time), abs=1e-9)
    assert new.state(end).position == pytest.approx([0.1, 0.2, 0.0], abs=1e-9)


def test_a_foot_that_meets_no_ground_goes_on_down_faster_and_faster(path):
    """0.15 m/s and 80 m/s³ for 80 ms, then at that speed."""
    for late, way in ((0.05, 0.15 * 0.05 + 80.0 * 0.05**3 / 6), (0.1, 0.015 + 6.827e-3 + 5.12e-3)):
        assert path.state(1.3 + late).position == pytest.approx([0.25, 0.12, -way], abs=1e-5)
    for time in (1.3, 1.35, 1.379, 1.42):
        rise = path.state(time + 1e-6).position[2] - path.state(time - 1e-6).position[2]
        assert path.state(time).velocity[2] == pytest.approx(rise / 2e-6, abs=1e-4)


@pytest.mark.parametrize(("start", "goal"), [(START, STAIR), (STAIR, GOAL)])
def test_between_heights_it_is_as_high_above_the_higher_footprint(start, goal):
    path = SwingPath.between(start, goal, begin=1.0, end=1.5, height=0.05)
    heights = [path.state(time).position[2] for time in np.linspace(1.0, 1.5, 101)]
    assert heights[0] == pytest.approx(start.z)
    assert heights[-1] == pytest.approx(goal.z)
    assert max(heights) == pytest.approx(0.11, abs=1e-3)


def test_goals_that_go_up_and_down_do_not_raise_the_foot(path):
    higher = Footprint(Foot.LEFT, 0.25, 0.12, 0.2, 0.03)
    for tick in range(10):
        path = path.retargeted(GOAL if tick % 2 else higher, time=1.0 + 5e-3 * tick, end=1.3)
    heights = [path.state(time).position[2] for time in np.linspace(1.0, 1.3, 61)]
    assert max(heights) == pytest.approx(0.05, abs=2e-3)


def test_the_gains_of_the_peak_are_the_acceleration_of_the_quintic(path):
    middle = path.state(1.1)
    new = path.retargeted(OTHER, time=1.1, end=1.35)
    of_distance, of_velocity, of_acceleration = peak_gains()
    T, D = 0.25, OTHER.x - middle.position[0]
    for k, s in enumerate(PEAK_SAMPLES):
        expected = (
            of_distance[k] * D / T**2
            + of_velocity[k] * middle.velocity[0] / T
            + of_acceleration[k] * middle.acceleration[0]
        )
        assert new.state(1.1 + s * T).acceleration[0] == pytest.approx(expected, abs=1e-9)
