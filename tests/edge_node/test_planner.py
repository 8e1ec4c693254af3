"""The edge's planners: complete plans within reach, as the pendulum goes, from the robot's feet."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from edge_node.planner import (
    PathPlanner,
    StandingPlanner,
    Velocity,
    WalkPlanner,
    make_planner,
)
from shared.motion import footstep_search
from shared.motion.footsteps import standing_footprints
from shared.motion.ground import make_ground
from shared.motion.planned import PlannedMotion
from shared.motion.stance import Stance, middle
from shared.motion.step_law import make_step_law
from shared.robots import Foot
from shared.wbc.contacts import ContactMode
from shared.wire.messages import RobotState, StepReport
from shared.wire.operator.commands import DRIVE_NS, Drive

DOUBLE = ContactMode.DOUBLE_SUPPORT


@pytest.fixture(scope="module")
def walk(configured):
    return configured(
        **{
            "task": "walk",
            "wire.projector_dtype": "float32",
            "stepping.mode": "on",
            "wbc.balance.law": "dcm",
            "walk.step_duration": 0.5,
        }
    )


def state(robot, *, phase=0, phase_ns=0, mode=DOUBLE, feet=None):
    prints = feet or standing_footprints(robot)
    report = StepReport(
        phase=phase,
        phase_ns=phase_ns,
        plan=-1,
        law=0,
        feet=(prints[Foot.LEFT], prints[Foot.RIGHT]),
        swing=None,
        disturbance=np.zeros(2),
    )
    v = np.zeros(robot.model.nv)
    return RobotState(1, 5, 1_000, 0, mode, robot.q_standing, v, steps=report)


def at_rest(robot, feet=None):
    com = np.zeros((2, 2))
    com[0] = Stance.of(robot).rest_over(feet or standing_footprints(robot))
    return com


def ends(plan):
    """Where the feet stand after a plan."""
    feet = {each.foot: each for each in plan.feet}
    feet.update({each.foot: each for each in plan.footprints()})
    return middle(feet)


def test_a_walk_is_planned_to_its_end_and_within_reach(robot, walk):
    plan = WalkPlanner(robot, walk).plan(state(robot), com=at_rest(robot), number=3)
    assert plan.number == 3
    assert len(plan.footprints()) == walk.walk.steps
    assert plan.phases[-1].mode is DOUBLE
    x, y, yaw = ends(plan)
    x_0, _, _ = middle(standing_footprints(robot))
    assert (x - x_0, y, yaw) == pytest.approx((0.5, 0.0, 0.0), abs=1e-9)
    law = make_step_law(robot, Stance.of(robot))
    feet = {each.foot: each for each in plan.feet}
    for goal in plan.footprints():
        support = feet[Foot.RIGHT if goal.foot is Foot.LEFT else Foot.LEFT]
        assert abs(goal.x - support.x) <= law.footholds_x[-1]
        assert law.footholds_y[0] <= abs(goal.y - support.y) <= law.footholds_y[-1]
        feet[goal.foot] = goal


def test_the_dcm_of_a_plan_is_continuous_and_comes_to_rest(robot, walk):
    """ξ leaves the CoP of a phase by e^{ωt}, from where the phase before has left it."""
    plan = WalkPlanner(robot, walk).plan(state(robot), com=at_rest(robot), number=0)
    omega = Stance.of(robot).omega
    dcm = at_rest(robot)[0]
    for phase in plan.phases:
        cop = np.array(phase.cop)
        growth = math.exp(omega * (phase.end_ns - phase.begin_ns) * 1e-9)
        dcm = cop + (dcm - cop) * growth
        assert dcm == pytest.approx(phase.dcm, abs=1e-6)
        dcm = np.array(phase.dcm)
    assert dcm == pytest.approx(phase.cop)


def test_a_planned_motion_follows_its_plan(robot, walk):
    """The DCM of the reference is that of the plan, and the motion has no jump."""
    plan = WalkPlanner(robot, walk).plan(state(robot), com=at_rest(robot), number=0)
    assert plan is not None
    motion, omega = PlannedMotion(plan, robot), Stance.of(robot).omega
    for phase in plan.phases[:-1]:
        reference = motion.reference(phase.end_ns - 1)
        dcm = reference.com[:2] + reference.com_velocity[:2] / omega
        assert dcm == pytest.approx(phase.dcm, abs=1e-3)
        assert motion.next_switch(phase.begin_ns) == phase.end_ns
    last_ns = plan.phases[-1].begin_ns
    assert motion.next_switch(last_ns) is None
    coms = np.array([motion.reference(k * 2_000_000).com for k in range(last_ns // 2_000_000)])
    assert np.abs(np.diff(coms, axis=0)).max() < 2e-3
    end = motion.reference(plan.phases[-1].end_ns + 10**9)
    assert end.mode is DOUBLE
    assert end.com_velocity == pytest.approx(np.zeros(3), abs=1e-3)


def test_in_a_step_the_plan_begins_with_that_step(robot, walk):
    planner = WalkPlanner(robot, walk)
    report = state(robot, phase=1, phase_ns=200_000_000, mode=ContactMode.RIGHT_SUPPORT)
    plan = planner.plan(report, com=at_rest(robot), number=0)
    assert plan.phases[0].mode is ContactMode.RIGHT_SUPPORT
    assert plan.phases[0].footprint.foot is Foot.LEFT
    assert len(plan.footprints()) == walk.walk.steps
    done = state(robot, phase=12, mode=DOUBLE)
    assert planner.plan(done, com=at_rest(robot), number=1) is None


@pytest.mark.parametrize("goal", [(0.6, 0.2, 0.5), (-0.3, 0.0, 0.0), (0.0, -0.25, -0.4)])
def test_a_robot_that_replans_at_every_stop_arrives_at_its_goal(robot, walk, goal):
    planner = PathPlanner(robot, walk)
    planner.goal = goal
    feet = standing_footprints(robot)
    for _ in range(6):
        plan = planner.plan(state(robot, feet=feet), com=at_rest(robot, feet), number=0)
        if plan is None:
            break
        feet.update({each.foot: each for each in plan.footprints()})
    else:
        pytest.fail("the goal is not reached after six plans")
    x, y, yaw = middle(feet)
    assert math.dist((x, y), goal[:2]) < 0.03
    assert abs(yaw - goal[2]) < math.radians(4.0)


def test_a_velocity_gives_steps_and_none_a_stand(robot, walk):
    planner = PathPlanner(robot, walk)
    assert planner.plan(state(robot), com=at_rest(robot), number=0) is None
    planner.velocity = Velocity(forward=0.2)
    plan = planner.plan(state(robot), com=at_rest(robot), number=0)
    first, second, *_ = plan.footprints()
    assert second.x - first.x == pytest.approx(0.1)


def test_a_state_with_a_wrong_time_does_not_let_a_velocity_hold_for_ever(robot, walk):
    planner = PathPlanner(robot, walk)
    planner.steer(Drive(forward=0.2, left=0.0, turning=0.0))
    assert not planner.expires(2**62)
    begun_ns = 10**9
    times = range(begun_ns, begun_ns + DRIVE_NS, 10**8)
    assert not any(planner.expires(now_ns) for now_ns in times)
    assert planner.expires(begun_ns + DRIVE_NS + 1)
    assert planner.velocity == Velocity()


def test_feet_that_stand_apart_come_together(robot, walk):
    planner = StandingPlanner(robot, walk)
    feet = standing_footprints(robot)
    assert (
        planner.plan(state(robot, phase=4, phase_ns=2 * 10**9), com=at_rest(robot), number=0)
        is None
    )
    feet[Foot.LEFT] = dataclasses.replace(feet[Foot.LEFT], x=0.25)
    early = state(robot, phase=4, phase_ns=10**8, feet=feet)
    assert planner.plan(early, com=at_rest(robot, feet), number=0) is None
    plan = planner.plan(
        state(robot, phase=4, phase_ns=2 * 10**9, feet=feet), com=at_rest(robot, feet), number=0
    )
    after = {each.foot: each for each in plan.footprints()}
    assert after[Foot.LEFT].x == pytest.approx(after[Foot.RIGHT].x, abs=1e-9)
    assert after[Foot.LEFT].y - after[Foot.RIGHT].y == pytest.approx(Stance.of(robot).width)


@pytest.mark.parametrize("mode", ["on", "edge"])
def test_a_step_is_as_high_as_the_settings_say(robot, configured, mode):
    task = "walk" if mode == "on" else "balance"
    settings = {"task": task, "stepping.mode": mode, "wbc.balance.law": "dcm"}
    settings |= {"stepping.swing_height": 0.07, "wire.projector_dtype": "float32"}
    law = make_step_law(robot, Stance.of(robot))
    planner = make_planner(robot, configured(**settings), law)
    com = at_rest(robot)
    com[0, 0] += 0.16  # of a pushed robot: beyond its toes
    plan = planner.plan(state(robot), com=com, number=1)
    assert plan is not None
    assert plan.footprints()
    assert plan.swing_height == 0.07


def test_the_task_go_has_the_goal_of_the_settings(robot, configured):
    settings = {"stepping.mode": "on", "wbc.balance.law": "dcm", "walk.goal": "0.3,0.1,20deg"}
    config = configured(**{"task": "go", "wire.projector_dtype": "float32", **settings})
    planner = make_planner(robot, config, make_step_law(robot, Stance.of(robot)))
    plan = planner.plan(state(robot), com=at_rest(robot), number=0)
    assert plan is not None
    assert ends(plan) == pytest.approx((0.3, 0.1, math.radians(20.0)), abs=0.03)


@pytest.mark.parametrize("landed", list(Foot))
def test_in_place_the_feet_take_turns(robot, configured, landed):
    """The feet are side by side. The DCM goes to the foot that has just landed, so the other one
    lifts.
    """
    settings = {"stepping.mode": "on", "wbc.balance.law": "dcm", "walk.step_length": 0.0}
    config = configured(**{"task": "walk", "wire.projector_dtype": "float32", **settings})
    com = at_rest(robot)
    com[0, 1] = 0.03 if landed is Foot.LEFT else -0.03
    report = state(robot, phase=2, phase_ns=10_000_000)
    plan = WalkPlanner(robot, config).plan(report, com=com, number=0)
    assert plan is not None
    first, second, *_ = plan.footprints()
    assert second.foot is landed
    assert first.foot is not landed


@pytest.fixture
def over_stairs(robot, configured):
    config = configured(
        **{
            "task": "go",
            "ground": "stairs:3x6cm",
            "duration": 20.0,
            "walk.goal": "0.6,0",
            "walk.step_length": 0.35,
            "walk.com_lowering": 0.03,
            "stepping.mode": "on",
            "wbc.balance.law": "dcm",
        }
    )
    return make_planner(robot, config, make_step_law(robot, Stance.of(robot)))


def test_over_a_known_ground_the_plan_has_the_heights_of_the_stairs(robot, over_stairs):
    planner = over_stairs
    plan = planner.plan(state(robot), com=at_rest(robot), number=0)
    ground = make_ground("stairs:3x6cm", seed=0)
    prints = plan.footprints()
    heights = [each.z for each in prints]
    assert heights == pytest.approx([ground.height(each.x, each.y) for each in prints])
    assert max(heights) == pytest.approx(0.12)
    # A step further on the way, the rest of it is planned.
    feet = standing_footprints(robot) | {prints[0].foot: prints[0]}
    rest = planner.plan(state(robot, phase=2, feet=feet), com=at_rest(robot, feet), number=1)
    assert rest.footprints() == prints[1:]
    # Off the way it is searched again, from where the feet are.
    feet = {
        foot: dataclasses.replace(each, y=each.y + 0.08)
        for foot, each in standing_footprints(robot).items()
    }
    other = planner.plan(state(robot, phase=2, feet=feet), com=at_rest(robot, feet), number=2)
    assert ends(other) == pytest.approx((*ends(plan)[:2], 0.0), abs=1e-6)


@pytest.mark.parametrize("landed", list(Foot))
def test_a_way_that_begins_anew_at_a_landing_goes_on_with_the_other_foot(
    robot, over_stairs, landed
):
    """The DCM is on its way to the foot that has landed, and has no time to turn back."""
    feet = {
        foot: dataclasses.replace(each, y=each.y + 0.08)
        for foot, each in standing_footprints(robot).items()
    }
    com = at_rest(robot, feet)
    com[0, 1] += 0.03 if landed is Foot.LEFT else -0.03
    moving = state(robot, phase=2, phase_ns=10_000_000, feet=feet)
    plan = over_stairs.plan(moving, com=com, number=0)
    assert plan is not None
    assert plan.footprints()[0].foot is not landed


def test_a_way_is_searched_a_part_at_a_time_and_each_robot_has_its_own(
    robot, over_stairs, monkeypatch
):
    monkeypatch.setattr(footstep_search, "_PART", 4)
    feet = {
        foot: dataclasses.replace(each, y=each.y + 0.06)
        for foot, each in standing_footprints(robot).items()
    }
    aside = state(robot, feet=feet)
    straight = dataclasses.replace(state(robot), session=aside.session + 1)
    parts, plan = 0, None
    while plan is None and parts < 1000:
        plan = over_stairs.plan(aside, com=at_rest(robot, feet), number=0)
        # The robot beside it goes its own way.
        other = over_stairs.plan(straight, com=at_rest(robot), number=0)
        assert other.feet == straight.steps.feet
        parts += 1
    assert parts > 1
    assert plan.feet == aside.steps.feet
    assert plan.footprints()[-1].x == pytest.approx(other.footprints()[-1].x)
