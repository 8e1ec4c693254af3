"""A planned walk: on the ground where it should be, continuous, with the ZMP in the support."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from shared.config.step_settings import WalkConfig
from shared.errors import ConfigError
from shared.motion.footsteps import Step, plan_footsteps
from shared.motion.standing import Standing
from shared.motion.walking import Walking
from shared.robots import GRAVITY, Foot
from shared.wbc.contacts import ContactMode

MS = 1_000_000
PLANS = {
    "forward": WalkConfig(),
    "paper's double support": WalkConfig(double_support=0.005),
    "long": WalkConfig(step_length=0.15),
    "backward": WalkConfig(step_length=-0.1),
    "in place": WalkConfig(step_length=0.0),
    "left": WalkConfig(step_length=0.0, step_sideways=0.05),
    "right": WalkConfig(step_length=0.0, step_sideways=-0.05),
    "turn": WalkConfig(steps=8, step_length=0.0, step_turn=math.radians(13)),
    "curve": WalkConfig(step_length=0.08, step_turn=math.radians(-8)),
    "one step": WalkConfig(steps=1, step_length=0.05),
}


@pytest.fixture(params=list(PLANS.values()), ids=list(PLANS))
def config(request):
    return request.param


@pytest.fixture
def walking(robot, config):
    return Walking(robot, config)


def sampled(walking, config, *, period_ms=5):
    for k in range(0, round(config.duration * 1000) + 100, period_ms):
        yield k * MS, walking.reference(k * MS)


def support_polygon(robot, walking, time_ns):
    """Corners of the loaded soles at a time, (n, 2)."""
    soles = {foot.side: foot.corners()[:, :2] for foot in robot.soles}
    phase = walking._phase(time_ns)
    if phase.step is None:
        prints = [walking.steps[0].support, walking.steps[0].start]
    else:
        step = phase.step
        double = phase.mode is ContactMode.DOUBLE_SUPPORT
        prints = [step.support, step.goal] if double else [step.support]
    return np.array([each.to_world(tuple(c)) for each in prints for c in soles[each.foot]])


def outside(point, corners):
    """Distance of a point from the hull of corners, by its support function in 64 directions."""
    angles = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    return float(np.max(normals @ point - (normals @ corners.T).max(axis=1)))


def test_the_zmp_stays_in_the_support_polygon(robot, walking, config):
    for time_ns, _ in sampled(walking, config):
        zmp = walking.com_plan.state(time_ns * 1e-9).zmp
        assert outside(zmp, support_polygon(robot, walking, time_ns)) < 1e-9, time_ns


def test_the_com_obeys_the_pendulum(walking, config):
    omega = walking.com_plan.omega
    for time_ns, reference in sampled(walking, config, period_ms=37):
        if time_ns < config.duration * 1e9:
            state = walking.com_plan.state(time_ns * 1e-9)
            expected = omega**2 * (reference.com[:2] - state.zmp)
            np.testing.assert_allclose(reference.com_acceleration[:2], expected, atol=1e-9)


def test_the_zmp_of_the_com_is_the_planned_one(walking):
    plan = walking.com_plan
    for segment in plan.segments:
        for share in (0.01, 0.5, 0.99):
            time = segment.begin + share * (segment.finish - segment.begin)
            planned = segment.start + share * (segment.end - segment.start)
            np.testing.assert_allclose(plan.state(time).zmp, planned[:2], atol=1e-10)


def test_the_com_is_at_the_height_of_standing(robot, walking, config):
    height = Standing(robot).reference(0).com[2]
    for _, reference in sampled(walking, config, period_ms=37):
        assert reference.com[2] == pytest.approx(height, rel=1e-12)
        assert reference.com_velocity[2] == reference.com_acceleration[2] == 0.0


def test_position_is_continuous_and_velocity_its_derivative(walking, config):
    references = [reference for _, reference in sampled(walking, config, period_ms=1)]
    com = np.array([(each.com, each.com_velocity) for each in references])
    swings = [each.swing for each in references]
    # Without a swing foot: NaN, and so is a difference to it.
    swung = np.array(
        [
            np.full((2, 3), np.nan) if each is None else (each.position, each.velocity)
            for each in swings
        ]
    )
    assert np.isfinite(swung).all(axis=(1, 2)).sum() > 500
    # The acceleration is below 5 m/s² on all plans: a step of the trapezoidal rule errs by less
    # than 1 ms · 5 m/s² · 1 ms.
    for samples, error in ((com, 5e-6), (swung, 2e-5)):
        position, velocity = samples.transpose(1, 0, 2)
        moved, mean = np.diff(position, axis=0), (velocity[1:] + velocity[:-1]) / 2
        np.testing.assert_allclose(moved, mean * 1e-3, atol=error)


def test_the_walk_begins_and_ends_at_rest_between_the_feet(robot, walking, config):
    begin = walking.reference(0)
    np.testing.assert_allclose(begin.com_velocity, 0.0, atol=1e-9)
    end = walking.reference(round(config.duration * 1e9))
    last = walking.steps[-1]
    centre = (walking._zmp(last.support) + walking._zmp(last.goal)) / 2
    # e^{−ω · 1.6 s} of some 0.1 m of sway is left of the swing to rest.
    np.testing.assert_allclose(end.com[:2], centre, atol=3e-3)
    assert not np.any(end.com_velocity)


def test_a_loaded_foot_is_on_the_ground_where_it_landed(walking, config):
    landed = {step.start.foot: step.start for step in reversed(walking.steps)}
    landed |= {walking.steps[0].support.foot: walking.steps[0].support}
    for phase in walking.phases:
        step = phase.step
        if step is None or phase.mode is ContactMode.DOUBLE_SUPPORT:
            continue
        assert step.support == landed[step.support.foot]
        first = walking.reference(phase.begin_ns).swing
        last = walking.reference(phase.end_ns - 1).swing
        start = landed[step.swing_foot]
        np.testing.assert_allclose(first.position, [start.x, start.y, 0.0], atol=1e-12)
        np.testing.assert_allclose(last.position, [step.goal.x, step.goal.y, 0.0], atol=1e-9)
        top = walking.reference((phase.begin_ns + phase.end_ns) // 2).swing
        assert top.position[2] == pytest.approx(config.swing_height, rel=1e-3)
        landed[step.swing_foot] = step.goal


def test_feet_alternate_and_never_cross(walking):
    for before, after in zip(walking.steps, walking.steps[1:], strict=False):
        assert after.swing_foot is before.support.foot
    for step in walking.steps:
        dx, dy = step.goal.position - step.support.position
        lateral = -math.sin(step.support.yaw) * dx + math.cos(step.support.yaw) * dy
        assert (lateral if step.swing_foot is Foot.LEFT else -lateral) > 0.1


def test_switches_are_announced_at_their_times(walking):
    time_ns = 0
    for phase, following in zip(walking.phases, walking.phases[1:], strict=False):
        assert walking.next_switch(phase.begin_ns) == phase.end_ns
        assert walking.next_switch(phase.end_ns - 1) == phase.end_ns
        assert walking.reference(phase.end_ns - 1).mode is phase.mode
        assert walking.reference(phase.end_ns).mode is following.mode
        time_ns = phase.end_ns
    assert walking.next_switch(time_ns) is None


UP_AND_DOWN = (0.06, 0.06, 0.12, 0.12, 0.04, 0.04)


def raised(step, heights):
    """A step of a level walk, with its footprints at these heights."""
    support, start, goal = (
        dataclasses.replace(each, z=heights[each]) for each in (step.support, step.start, step.goal)
    )
    return Step(support, start, goal)


@pytest.fixture(scope="module")
def stairs(robot):
    """Six steps, up two stairs and down to another one."""
    config = WalkConfig()
    steps = plan_footsteps(robot, config)
    heights = dict.fromkeys((steps[0].support, steps[0].start), 0.0)
    heights |= {step.goal: z for step, z in zip(steps, UP_AND_DOWN, strict=True)}
    return Walking(robot, config, steps=tuple(raised(step, heights) for step in steps))


def test_on_stairs_the_force_at_the_com_passes_through_the_planned_zmp(robot, stairs):
    """m (c̈ + g) points from the ZMP, at the height of the ground, to the CoM."""
    standing = Standing(robot).reference(0).com[2]
    assert stairs.com_plan.motion(0.0)[0, 2] == pytest.approx(standing, abs=1e-12)
    assert stairs.com_plan.motion(9.0)[0, 2] == pytest.approx(standing + 0.04, abs=1e-3)
    for segment in stairs.com_plan.segments:
        for share in (0.01, 0.5, 0.99):
            time = segment.begin + share * (segment.finish - segment.begin)
            com, _, acceleration = stairs.com_plan.motion(time)
            zmp = segment.start + share * (segment.end - segment.start)
            force = acceleration + np.array([0.0, 0.0, GRAVITY])
            np.testing.assert_allclose(np.cross(com - zmp, force), 0.0, atol=1e-9)


def test_on_stairs_a_foot_rises_first_and_passes_above_both_footprints(stairs):
    for phase in stairs.phases[1::2]:
        step, duration = phase.step, phase.end_ns - phase.begin_ns
        path = [stairs.reference(phase.begin_ns + k * duration // 100).swing for k in range(100)]
        heights = np.array([each.position[2] for each in path])
        assert heights[0] == pytest.approx(step.start.z, abs=1e-12)
        assert heights[-1] == pytest.approx(step.goal.z, abs=1e-4)
        higher = max(step.start.z, step.goal.z)
        assert heights[50] == pytest.approx(higher + WalkConfig().swing_height, abs=1e-12)
        # It is above the higher stair before a third of the way, and until the last third.
        way = [math.dist(each.position[:2], step.start.position) for each in path]
        over = np.array(way) / math.dist(step.goal.position, step.start.position)
        assert np.all(heights[(over > 0.2) & (over < 0.8)] > higher)


def test_a_foot_clears_the_ground_between_its_footprints(robot):
    step = dataclasses.replace(plan_footsteps(robot, WalkConfig())[1], highest=0.03)
    assert step.obstacle == 0.03
    high = dataclasses.replace(step, goal=dataclasses.replace(step.goal, z=0.1))
    assert high.obstacle == 0.0


def test_the_mpc_plan_refuses_stairs(robot, stairs):
    with pytest.raises(ConfigError, match="expected dcm over ground that is not level"):
        Walking(robot, WalkConfig(com_plan="mpc"), steps=stairs.steps)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"step_length": 0.6}, "legs reach"),
        ({"step_width": 0.08}, "cross or touch"),
        ({"step_turn": 1.0}, "turns the foot"),
    ],
)
def test_a_plan_that_cannot_be_walked_is_refused_with_the_reason(robot, changes, reason):
    with pytest.raises(ConfigError, match=reason):
        Walking(robot, WalkConfig(**changes))
