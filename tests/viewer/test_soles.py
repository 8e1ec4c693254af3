"""The limits of a sole in words, by its side."""

from __future__ import annotations

import numpy as np
import pytest

from shared.robots import Foot, Robot
from shared.wbc.contacts import ROWS_PER_FOOT, ROWS_PER_POINT
from tests.viewer.synthetic import tick_rows
from viewer.soles import SOLE_STATES, sole_state, sole_states

FRICTION, UNLOADED = 0b00100, 0b11111


def mask(foot: int, kinds: dict[int, int]) -> int:
    """The active set with these rows at these points of a foot."""
    return sum(
        rows << ROWS_PER_FOOT * foot + ROWS_PER_POINT * point for point, rows in kinds.items()
    )


def points(robot: Robot, side: str) -> list[int]:
    """The points of the left sole on one of its sides, by their places."""
    corners = robot.soles[0].corners()
    axis, sign = {"toe": (0, 1), "heel": (0, -1), "left": (1, 1), "right": (1, -1)}[side]
    middle = corners[:, axis].mean()
    return [k for k in range(4) if sign * (corners[k, axis] - middle) > 0]


@pytest.mark.parametrize("foot", range(len(Foot)))
@pytest.mark.parametrize("side", ["toe", "heel", "left", "right"])
def test_a_side_is_where_its_points_are(robot: Robot, foot: int, side: str) -> None:
    active = mask(foot, dict.fromkeys(points(robot, side), UNLOADED))
    name = side if side in ("toe", "heel") else f"{side} side"
    assert sole_state(active, foot) == f"{name}: unloaded"
    assert sole_state(active, 1 - foot) == ""


def test_a_side_with_a_loaded_point_at_its_friction_is_at_its_friction() -> None:
    assert sole_state(mask(0, {0: UNLOADED, 1: FRICTION}), 0) == "heel: friction"


def test_every_active_set_has_a_state_with_a_colour() -> None:
    for at_limit in range(1, 16):
        kinds = {k: FRICTION for k in range(4) if at_limit >> k & 1}
        assert sole_state(mask(1, kinds), 1) in SOLE_STATES
    assert sole_state(0, 0) == sole_state(-1, 1) == ""


def test_a_limit_of_one_tick_is_in_its_span(robot: Robot) -> None:
    schema, rows = tick_rows(robot, 60)
    rows[:, schema.slices["active_set"]] = -1.0
    rows[27, schema.slices["active_set"]] = float(mask(0, {3: FRICTION}))
    first, (left, right) = sole_states(schema, rows)
    np.testing.assert_array_equal(first, [0, 20, 40])
    assert left == ["", "toe left: friction", ""]
    assert right == ["", "", ""]
