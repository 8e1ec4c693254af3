"""Grounds: described in a word or in a file, and what lies under a sole."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shared.config.quantities import parse_ground
from shared.errors import ConfigError
from shared.motion.ground import FLAT, HOLE, Ground, Patch, make_ground, read_ground
from shared.robots import Foot

STAIRS = Ground((Patch((0.3, 0.6), (-1.0, 1.0), 0.06), Patch((0.6, 2.0), (-1.0, 1.0), 0.12)))


def sole(robot, x, y, yaw=0.0):
    foot = next(each for each in robot.soles if each.side is Foot.LEFT)
    c, s = math.cos(yaw), math.sin(yaw)
    return foot.corners()[:, :2] @ np.array([[c, s], [-s, c]]) + (x, y)


@pytest.mark.parametrize(
    ("text", "heights"),
    [
        ("flat", {0.5: 0.0, 3.0: 0.0}),
        ("stairs:3x6cm", {0.19: 0.0, 0.21: 0.06, 0.51: 0.12, 0.81: 0.18, 2.2: 0.12, 3.0: 0.0}),
        ("stairs:1x-40mm", {0.19: 0.0, 0.21: -0.04, 1.6: 0.0}),
        ("gap:10cm", {0.34: 0.0, 0.36: HOLE, 0.44: HOLE, 0.46: 0.0}),
        ("slope:8deg", {0.2: 0.0, 1.2: math.tan(math.radians(8)), 2.0: 0.2108, 4.3: 0.0}),
    ],
)
def test_a_described_ground_has_its_heights(text, heights):
    ground = make_ground(text, seed=0)
    for x, z in heights.items():
        assert ground.height(x, 0.1) == pytest.approx(z, abs=1e-4), x
    assert ground.flat is (text == "flat")


def test_blocks_come_from_the_seed_and_stay_within_their_height():
    blocks = make_ground("blocks:2cm", seed=3)
    assert blocks == make_ground("blocks:2cm", seed=3) != make_ground("blocks:2cm", seed=4)
    z = np.array([each.z for each in blocks.patches])
    assert -0.02 <= z.min() < -0.015
    assert 0.015 < z.max() <= 0.02
    assert blocks.height(0.1, 0.1) == 0.0


def test_heights_of_many_points_are_those_of_each():
    points = np.random.default_rng(0).uniform(-0.5, 2.5, (200, 2))
    for ground in (FLAT, STAIRS, make_ground("slope:8deg", seed=0)):
        one_by_one = [ground.height(*point) for point in points.tolist()]
        np.testing.assert_array_equal(ground.heights(points), one_by_one)


def test_a_sole_is_level_on_one_stair_and_not_across_an_edge(robot):
    # The sole reaches from −0.0735 to 0.12 m.
    assert STAIRS.is_level(sole(robot, 0.38, 0.1))
    assert not STAIRS.is_level(sole(robot, 0.37, 0.1))
    assert not STAIRS.is_level(sole(robot, 0.49, 0.1))
    assert STAIRS.is_level(sole(robot, 0.49, 0.1), tolerance=0.061)
    # Turned by 90° it is narrower along x, and wider along y.
    assert STAIRS.is_level(sole(robot, 0.37, 0.0, yaw=math.pi / 2))
    assert not STAIRS.is_level(sole(robot, 0.4, 0.95))
    assert not make_ground("slope:8deg", seed=0).is_level(sole(robot, 1.0, 0.0))


def test_a_sole_does_not_stand_on_forbidden_ground(robot):
    ground = Ground((Patch((0.0, 1.0), (0.0, 1.0), 0.0, allowed=False),))
    assert not ground.is_level(sole(robot, 0.5, 0.5))
    assert ground.is_level(sole(robot, 0.5, -0.5))


@pytest.fixture
def file(tmp_path):
    def write(**changes):
        heights = np.zeros((30, 20))
        heights[20:, :] = 0.06
        heights[25, 3] = np.nan
        arrays = {"heights": heights, "cell": 0.05, "origin": np.array([-0.5, -0.5]), **changes}
        path = tmp_path / "ground.npz"
        np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
        return path

    return write


def test_a_file_has_cells_holes_and_forbidden_places(file):
    forbidden = np.zeros((30, 20), dtype=bool)
    forbidden[22, 10] = True
    ground = read_ground(file(forbidden=forbidden))
    assert ground.height(0.0, 0.0) == 0.0
    assert ground.height(0.51, 0.0) == 0.06
    assert ground.height(0.77, -0.33) == HOLE
    assert ground.height(1.1, 0.0) == 0.0
    assert ground.allowed(np.array([[0.61, 0.01], [0.61, 0.06]])).tolist() == [False, True]
    area = sum((p.x[1] - p.x[0]) * (p.y[1] - p.y[0]) for p in ground.patches)
    assert area == pytest.approx(1.5 * 1.0)
    assert len(ground.patches) < 20


NOISE = np.random.default_rng(0).uniform(-0.1, 0.1, (100, 100))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"heights": None}, "expected arrays heights, cell and origin, got cell, origin"),
        ({"heights": np.zeros(3)}, "expected a table"),
        ({"heights": np.zeros((501, 2))}, "at most 500 × 500"),
        ({"heights": np.array([["a"]])}, "expected numbers"),
        ({"heights": np.array([[None]])}, "allow_pickle"),
        ({"heights": np.full((30, 20), 3.0)}, "at most ±1 m"),
        ({"heights": np.full((30, 20), 0.1)}, "level ground of height 0 within 0.15 m"),
        ({"heights": NOISE}, "at most 2000 rectangles"),
        ({"cell": 0.0}, "cell: expected a length of 0.01 to 1 m"),
        ({"cell": math.nan}, "cell: expected"),
        ({"origin": np.zeros(3)}, "origin: expected two coordinates"),
        ({"origin": np.array([math.inf, 0.0])}, "origin: expected two coordinates"),
        ({"forbidden": np.zeros((2, 2), dtype=bool)}, "forbidden: expected truth values"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_a_line(file, changes, reason):
    with pytest.raises(ConfigError, match=reason) as error:
        read_ground(file(**changes))
    assert "\n" not in str(error.value)


def test_a_missing_file_and_one_of_another_kind_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        read_ground(tmp_path / "absent.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(ConfigError, match=r"text\.npz: .*zip"):
        read_ground(tmp_path / "text.npz")


@pytest.mark.parametrize(
    "text",
    [
        *("", "stairs", "stairs:3", "stairs:x6cm", "stairs:0x6cm", "stairs:99x6cm", "stairs:3x6kg"),
        *("blocks:-2cm", "blocks:2x2cm", "blocks:0cm", "gap:9m", "gap:nan", "slope:80deg", "hill"),
        *("flat:2cm", "flat ", "stairs:3x6cm,gap:1cm", "blocks:1e9cm", "heights.csv"),
    ],
)
def test_a_ground_that_is_none_is_refused_with_the_forms_that_are(text):
    with pytest.raises(ConfigError, match="expected flat, blocks:2cm, stairs:3x6cm"):
        parse_ground(text)
