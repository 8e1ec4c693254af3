"""Footsteps to a goal: every step can be made, on level ground, and the search always ends."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from shared.config.config_file import load_config
from shared.config.quantities import parse_goal
from shared.motion import footstep_search
from shared.motion.footstep_search import FootstepSearch, NoFootstepsError, find_footsteps
from shared.motion.footsteps import MAX_TURN, standing_footprints
from shared.motion.ground import FLAT, Ground, Patch, make_ground
from shared.motion.height_table import HeightTable
from shared.motion.walking import Walking
from shared.robots import Foot
from shared.robots.standing import leg_length
from shared.wbc.contacts import ContactMode

WALLS = Ground(
    (
        Patch((0.6, 0.7), (-2.0, 0.0), 0.4),
        Patch((1.3, 1.6), (-2.0, 2.0), 0.05),
    )
)
PROBLEMS = {
    "ahead": (FLAT, "1,0"),
    "to the left": (FLAT, "0,0.4"),
    "backward": (FLAT, "-0.3,0"),
    "turn": (FLAT, "0,0,-90deg"),
    "in place": (FLAT, "0,0"),
    "all of it": (FLAT, "1,0.5,90deg"),
    "stairs": (make_ground("stairs:3x6cm", seed=0), "1.2,0"),
    "over the stairs": (make_ground("stairs:2x6cm", seed=0), "2.6,0"),
    "down": (make_ground("stairs:2x-5cm", seed=0), "1,0"),
    "gap": (make_ground("gap:10cm", seed=0), "0.9,0"),
    "blocks": (make_ground("blocks:2cm", seed=1), "1.5,0.3"),
    "walls": (WALLS, "1.9,0"),
}


@pytest.fixture(scope="module")
def walk():
    return load_config(None, {"task": "go"}).walk


@pytest.fixture(scope="module", params=list(PROBLEMS), ids=str)
def problem(request, robot, walk):
    ground, text = PROBLEMS[request.param]
    goal = parse_goal(text)
    return ground, goal, find_footsteps(robot, walk, ground, goal)


def corners(robot, footprint):
    foot = next(each for each in robot.soles if each.side is footprint.foot)
    return np.array([footprint.to_world((x, y)) for x, y in foot.corners()[:, :2].tolist()])


def test_the_feet_alternate_from_standing_to_the_goal(robot, problem):
    _, goal, steps = problem
    feet = standing_footprints(robot)
    middle_x = (feet[Foot.LEFT].x + feet[Foot.RIGHT].x) / 2
    for before, after in itertools.pairwise(steps):
        assert after.support == before.goal
    for step in steps:
        assert step.start == feet[step.swing_foot]
        assert step.support == feet[step.support.foot]
        feet[step.swing_foot] = step.goal
    base = (feet[Foot.LEFT].position + feet[Foot.RIGHT].position) / 2
    base -= middle_x * np.array([math.cos(goal.yaw), math.sin(goal.yaw)])
    assert np.linalg.norm(base - (goal.x, goal.y)) < 0.24
    assert feet[Foot.LEFT].yaw == feet[Foot.RIGHT].yaw == goal.yaw


def test_every_sole_is_on_level_ground_at_its_height(robot, problem):
    ground, _, steps = problem
    for step in steps:
        assert ground.is_level(corners(robot, step.goal), tolerance=3e-3)
        assert ground.height(step.goal.x, step.goal.y) == pytest.approx(step.goal.z, abs=3e-3)


def test_every_step_is_within_reach_and_keeps_the_feet_apart(robot, walk, problem):
    stretched, height = leg_length(robot)
    feet = standing_footprints(robot)
    width = feet[Foot.LEFT].y - feet[Foot.RIGHT].y
    for step in problem[2]:
        x, y = step.goal.position - step.support.position
        c, s = math.cos(step.support.yaw), math.sin(step.support.yaw)
        side = 1.0 if step.swing_foot is Foot.LEFT else -1.0
        forward, sideways = c * x + s * y, side * (c * y - s * x)
        assert 0.13 < sideways < width + 0.2
        assert abs(math.remainder(step.goal.yaw - step.support.yaw, math.tau)) < MAX_TURN
        assert -0.13 < forward <= walk.step_length + 1e-9
        climb = abs(step.goal.z - step.support.z)
        hip = height - walk.com_lowering + climb / 2
        assert math.hypot(math.hypot(forward, sideways - width) / 2, hip) <= stretched + 1e-9
        swing = math.dist(step.goal.position, step.start.position)
        assert swing <= 0.5 * walk.step_duration


def test_no_swinging_sole_meets_the_ground(robot, walk, problem):
    ground, _, steps = problem
    walking = Walking(robot, walk, steps=steps)
    u = np.linspace(0.0, 1.0, 12)
    for phase in walking.phases:
        if phase.mode is ContactMode.DOUBLE_SUPPORT:
            continue
        for share in np.linspace(0.0, 0.999, 30):
            swing = walking.reference(
                phase.begin_ns + round(share * (phase.end_ns - phase.begin_ns))
            ).swing
            x, y, z = swing.position.tolist()
            at = dataclasses.replace(phase.step.goal, x=x, y=y, yaw=swing.yaw)
            (p00, p01, p10, _) = corners(robot, at)
            grid = p00 + u[:, None, None] * (p10 - p00) + u[:, None] * (p01 - p00)
            # Ground counts as level within 3 mm.
            assert z >= ground.heights(grid.reshape(-1, 2)).max() - 3e-3


def mirrored(ground):
    return Ground(
        tuple(dataclasses.replace(each, y=(-each.y[1], -each.y[0])) for each in ground.patches)
    )


@pytest.mark.parametrize("name", ["to the left", "all of it", "walls", "turn"])
def test_a_mirrored_problem_has_the_mirrored_solution(robot, walk, name):
    ground, text = PROBLEMS[name]
    goal = parse_goal(text)
    # No edge of the ground is on a border of the search's cells.
    ground = Ground(
        tuple(
            dataclasses.replace(each, y=(each.y[0] + 0.0043, each.y[1] + 0.0043))
            for each in ground.patches
        )
    )
    steps = find_footsteps(robot, walk, ground, goal)
    other = find_footsteps(
        robot, walk, mirrored(ground), dataclasses.replace(goal, y=-goal.y, yaw=-goal.yaw)
    )
    assert len(steps) == len(other)
    for step, image in zip(steps, other, strict=True):
        assert step.swing_foot is not image.swing_foot
        seen = (step.goal.x, step.goal.y, step.goal.yaw)
        np.testing.assert_allclose((image.goal.x, -image.goal.y, -image.goal.yaw), seen, atol=1e-9)


def test_forbidden_places_are_passed_by(robot, walk):
    lawn = Patch((0.5, 0.8), (-0.6, 0.0), 0.0)
    steps = find_footsteps(robot, walk, FLAT, parse_goal("1.4,0"), forbidden=[lawn])
    shut = Ground((dataclasses.replace(lawn, allowed=False),))
    assert all(shut.is_level(corners(robot, step.goal)) for step in steps)
    assert steps == find_footsteps(robot, walk, shut, parse_goal("1.4,0"))


@pytest.mark.parametrize(
    ("ground", "goal", "reason"),
    [
        ("gap:50cm", "1.2,0", "found no way to 1.2, 0"),
        ("stairs:1x18cm", "0.8,0", "found no way"),
        ("gap:50cm", "0.6,0", "expected level ground for both feet within 0.16 m of 0.6, 0"),
        ("slope:8deg", "1,0", r"another goal, or steps by touch over a slope \(--stepping on\)$"),
    ],
)
def test_a_goal_out_of_reach_is_refused_in_bounded_work(
    robot, walk, monkeypatch, ground, goal, reason
):
    monkeypatch.setattr(footstep_search, "MAX_EXPANSIONS", 60)
    with pytest.raises(NoFootstepsError, match=reason) as error:
        find_footsteps(robot, walk, make_ground(ground, seed=0), parse_goal(goal))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("goal", ["1.2,0", "1,0.3,30deg"])
def test_by_touch_the_way_leads_over_a_slope_of_even_ground(robot, walk, goal):
    ground, slope = make_ground("slope:8deg", seed=0), math.tan(math.radians(8.0))
    steps = find_footsteps(robot, walk, ground, parse_goal(goal), slopes=True)
    on_slope = [step.goal for step in steps if step.goal.x > 0.3]
    assert len(on_slope) >= 4
    for at in on_slope:
        plane = at.z + slope * (corners(robot, at)[:, 0] - at.x)
        np.testing.assert_allclose(ground.heights(corners(robot, at)), plane, atol=3e-3)
    steep = make_ground("slope:12deg", seed=0)
    with pytest.raises(NoFootstepsError):
        find_footsteps(robot, walk, steep, parse_goal(goal), slopes=True)


def test_from_any_stance_the_search_goes_on(robot, walk):
    """The feet of a step of a walk, with the left one ahead."""
    first = find_footsteps(robot, walk, FLAT, parse_goal("1,0"))
    feet = {first[1].support.foot: first[1].support, first[1].goal.foot: first[1].goal}
    start = feet[Foot.LEFT], feet[Foot.RIGHT]
    steps = find_footsteps(robot, walk, FLAT, parse_goal("1,0"), start=start)
    assert len(steps) < len(first)
    assert {steps[0].support, steps[0].start} == set(start)
    assert steps[-1].goal.x == pytest.approx(first[-1].goal.x)


@pytest.mark.parametrize(("aside", "tables"), [(0.1, 1), (-3.0, 2)])
def test_a_later_search_keeps_the_table_as_long_as_the_feet_are_on_it(
    robot, walk, monkeypatch, aside, tables
):
    made = []

    class Counted(HeightTable):
        def __init__(self, *args, **kwargs):
            made.append(self)
            super().__init__(*args, **kwargs)

    monkeypatch.setattr(footstep_search, "HeightTable", Counted)
    ground, goal = make_ground("stairs:1x5cm", seed=0), parse_goal("0.8,0")
    stance = standing_footprints(robot)
    left, right = (dataclasses.replace(stance[foot], y=stance[foot].y + aside) for foot in Foot)
    search = FootstepSearch(robot, walk, ground, goal)
    first = search.steps()
    steps = search.steps((left, right))
    assert len(made) == tables
    assert {steps[0].support, steps[0].start} == {left, right}
    assert steps[-1].goal == {each.goal.foot: each.goal for each in first}[steps[-1].goal.foot]


def test_a_step_too_short_to_get_anywhere_is_refused(robot, walk):
    short = dataclasses.replace(walk, step_length=0.01)
    with pytest.raises(Exception, match=r"walk\.step_length: expected at least 0\.03 m"):
        find_footsteps(robot, short, FLAT, parse_goal("1,0"))
