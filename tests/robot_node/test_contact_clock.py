"""The contact clock: phases by time and by touch, and what a plan changes."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from robot_node.node import RobotNode
from robot_node.step_rows import StepRows
from robot_node.stepping import ContactClock, Measured
from shared.motion.footsteps import standing_footprints
from shared.motion.plan_frame import PlanFrame
from shared.motion.planned import Plan, PlannedPhase, PlanOrigin
from shared.motion.stance import Stance
from shared.motion.standing import Standing
from shared.motion.step_law import make_step_law
from shared.robots import Foot
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import STEP_SCHEMA, FootprintKind
from shared.wbc.contacts import ContactMode
from shared.wire.operator.commands import Reset

DOUBLE, LEFT = ContactMode.DOUBLE_SUPPORT, ContactMode.LEFT_SUPPORT
MS = 1_000_000


class Bench:
    """A robot that stands still, with forces on its feet as the test wants them."""

    def __init__(self, robot, model, config):
        self.clock = ContactClock(robot, config)
        self._now = model.kinematics(robot.q_standing, np.zeros(robot.model.nv))
        self.force = dict.fromkeys(Foot, 200.0)
        self.disturbance = np.zeros(2)
        self.time_ns = 0
        self.steps = RowLog(STEP_SCHEMA)
        self.plan_frame = PlanFrame()
        self._q = robot.q_standing
        self._rows = StepRows(model)

    def run(self, ms):
        for _ in range(ms):
            forces = {foot: np.array([0.0, 0.0, force]) for foot, force in self.force.items()}
            measured = Measured(self._now, self.disturbance, forces)
            reference = self.clock.reference(measured, time_ns=self.time_ns)
            self._rows.fill(self.steps, self._moment(), self.clock)
            self.time_ns += MS
        return reference

    def _moment(self):
        """As that of a task that began 7 ms before its plan."""
        return SimpleNamespace(
            time_ns=self.time_ns + 7 * MS,
            wall_ns=self.time_ns,
            plan_ns=self.time_ns,
            plan_frame=self.plan_frame,
            q=self._q,
        )

    def footprints(self, kind):
        rows = self.steps.rows()
        return rows[STEP_SCHEMA.column(rows, "kind") == kind]


@pytest.fixture
def config(configured):
    return configured(**{"stepping.mode": "on", "wbc.balance.law": "dcm"})


@pytest.fixture
def bench(robot, model, config):
    return Bench(robot, model, config)


@pytest.fixture
def plan(bench):
    """100 ms on both feet, then a step of the right foot of 400 ms."""
    left, right = bench.clock.feet[Foot.LEFT], bench.clock.feet[Foot.RIGHT]
    goal = dataclasses.replace(right, x=right.x + 0.1)
    return Plan(
        number=0,
        origin=PlanOrigin(1, 0, 0),
        valid_until_ns=10**9,
        feet=(left, right),
        com=(0.03, 0.0),
        phases=(
            PlannedPhase(DOUBLE, 0, 100 * MS, None, (0.0, 0.0), (0.03, 0.0)),
            PlannedPhase(LEFT, 100 * MS, 500 * MS, goal, (0.0, 0.096), (0.1, 0.0)),
            PlannedPhase(DOUBLE, 500 * MS, 2500 * MS, None, (0.08, 0.0), (0.08, 0.0)),
        ),
        swing_height=0.05,
    )


def test_a_robot_at_rest_stands(bench, robot):
    bench.clock.law = make_step_law(robot, Stance.of(robot))
    reference = bench.run(300)
    assert bench.clock.phase == 0
    assert reference.mode is DOUBLE
    assert reference.com == pytest.approx(Standing(robot).reference(0).com, abs=1e-6)


def test_a_force_that_would_tip_the_robot_over_makes_it_step(bench, robot):
    """0.5 m ahead is what 300 N shift the CoP by; without a law nothing can be done."""
    bench.disturbance[0] = 0.5
    assert bench.run(20).mode is DOUBLE
    bench.clock.law = make_step_law(robot, Stance.of(robot))
    reference = bench.run(10)
    assert reference.mode is not DOUBLE
    assert reference.com_command is not None
    assert bench.clock.phase == 1


def test_without_a_law_the_robot_steps_as_planned(bench, plan):
    bench.clock.take(plan)
    assert bench.run(95).mode is DOUBLE
    bench.force[Foot.RIGHT] = 0.0
    reference = bench.run(60)
    assert (reference.mode, bench.clock.phase) == (LEFT, 1)
    bench.run(300)
    assert bench.clock.swing_path.goal == plan.phases[1].footprint


def test_a_foot_that_lands_early_bears_at_once(bench, plan):
    bench.clock.take(plan)
    bench.run(110)
    # In the first half of the swing the foot is still on its way up.
    bench.force[Foot.RIGHT] = 60.0
    assert bench.run(150).mode is LEFT
    assert bench.run(80).mode is DOUBLE
    assert bench.clock.phase == 2


def test_after_a_time_without_measurements_the_reference_does_not_jump(bench):
    before = bench.run(100)
    # A sole is known to a millimetre.
    bench.clock.feet = {
        foot: dataclasses.replace(each, z=each.z + 1e-3) for foot, each in bench.clock.feet.items()
    }
    bench.time_ns += 10_000 * MS
    after = bench.run(1)
    np.testing.assert_allclose(after.com, before.com, atol=1e-3)
    np.testing.assert_allclose(after.com_velocity, 0.0, atol=0.01)


def test_a_force_that_is_not_a_number_is_no_touch(bench, plan):
    bench.clock.take(plan)
    bench.run(110)
    bench.force[Foot.RIGHT] = math.nan
    assert bench.run(300).mode is LEFT


@pytest.mark.parametrize(("height", "lands"), [(0.05, True), (0.1, False)])
def test_a_foot_that_hits_an_edge_far_above_its_goal_has_not_landed(bench, plan, height, lands):
    step = plan.phases[1]
    lower = dataclasses.replace(step.footprint, z=step.footprint.z - height)
    step = dataclasses.replace(step, footprint=lower)
    bench.clock.take(dataclasses.replace(plan, phases=(plan.phases[0], step, plan.phases[2])))
    bench.run(110)
    bench.force[Foot.RIGHT] = 60.0
    assert bench.run(300).mode is (DOUBLE if lands else LEFT)


def test_a_foot_that_hits_an_edge_with_its_toe_has_not_landed(bench, plan, robot, model):
    bench.clock.take(plan)
    bench.run(110)
    q = robot.q_standing.copy()
    toe_down = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.6, 0.0)).coeffs()
    q[3:7] = toe_down
    q[2] -= model.sole_placements(q)[Foot.RIGHT].translation[2]
    bench._now = model.kinematics(q, np.zeros(robot.model.nv))
    assert bench._now.sole_placement(Foot.RIGHT).translation[2] == pytest.approx(0.0, abs=1e-9)
    bench.force[Foot.RIGHT] = 60.0
    assert bench.run(300).mode is LEFT


def test_a_foot_that_lands_late_goes_on_down(bench, plan):
    bench.clock.take(plan)
    bench.force[Foot.RIGHT] = 0.0
    reference = bench.run(600)
    assert reference.mode is LEFT
    assert reference.swing.position[2] < -0.01
    # Faster with every tick that it misses the ground: 80 m/s³ for 80 ms after 0.15 m/s.
    assert reference.swing.velocity[2] == pytest.approx(-0.15 - 0.5 * 80.0 * 0.08**2)
    bench.force[Foot.RIGHT] = 60.0
    assert bench.run(1).mode is DOUBLE


@pytest.mark.parametrize(("aside", "first"), [(0.01, LEFT), (0.05, DOUBLE)])
def test_a_step_waits_for_a_dcm_that_is_far_from_its_place(bench, plan, aside, first):
    """As after a foot that has landed early; towards the next support foot, and not for ever."""
    shift = dataclasses.replace(plan.phases[0], dcm=(0.03, aside))
    bench.clock.take(dataclasses.replace(plan, phases=(shift, *plan.phases[1:])))
    bench.force[Foot.RIGHT] = 0.0
    assert bench.run(150).mode is first
    assert bench.run(270).mode is LEFT


def test_the_com_is_as_high_over_the_feet_as_in_standing_less_its_lowering(
    robot, model, configured
):
    settings = {"stepping.mode": "on", "wbc.balance.law": "dcm", "walk.com_lowering": 0.03}
    clock = ContactClock(robot, configured(**settings))
    q = robot.q_standing.copy()
    q[2] += 0.02
    now = model.kinematics(q, np.zeros(robot.model.nv))
    forces = {foot: np.array([0.0, 0.0, 200.0]) for foot in Foot}
    for k in range(2000):
        measured = Measured(now, np.zeros(2), forces)
        reference = clock.reference(measured, time_ns=k * MS)
    standing = Standing(robot).reference(0).com[2]
    assert reference.com[2] == pytest.approx(standing + 0.02 - 0.03, abs=1e-4)
    assert reference.com_velocity[2] == pytest.approx(0.0, abs=1e-3)
    assert [each.z for each in clock.feet.values()] == pytest.approx([0.02, 0.02], abs=1e-4)


def test_after_the_last_step_of_a_plan_the_robot_stands(bench, plan):
    bench.clock.take(plan)
    bench.force[Foot.RIGHT] = 0.0
    bench.run(450)
    bench.force[Foot.RIGHT] = 60.0
    bench.run(400)
    assert bench.clock.phase == 2
    assert bench.clock.mode is DOUBLE


def test_a_robot_that_begins_anew_has_no_plan_and_its_own_law(robot, config, motion):
    node = RobotNode(robot, config, motion, session=1)
    node.clock.phase = 3
    node.clock.law = None
    node.plans.refused["stale"] += 1
    node.prepare(Reset())()
    assert node.clock.phase == 0
    assert node.clock.law is not None
    assert node.refused["stale"] == 1


def test_the_footprints_of_a_plan_are_rows_in_the_world_and_in_task_time(bench, plan):
    """The plan's frame is 2 m to the left and turned by a quarter."""
    bench.run(1)
    bench.plan_frame = PlanFrame(0.0, 2.0, math.pi / 2)
    bench.clock.take(plan)
    bench.force[Foot.RIGHT] = 0.0
    bench.run(450)
    bench.force[Foot.RIGHT] = 60.0
    bench.run(100)
    goal = plan.phases[1].footprint
    in_world = [-goal.y, 2.0 + goal.x, 0.0, math.pi / 2]
    (row,) = bench.footprints(FootprintKind.PLANNED)
    # On both feet for 100 ms from the begin of the plan, then 400 ms; the task is 7 ms older.
    assert row.tolist() == pytest.approx([MS, 8 * MS, 0, 0, 1, 1, *in_world, 507 * MS])
    assert not len(bench.footprints(FootprintKind.CHOSEN)), "there is no law"
    # The soles of the beginning are of no plan. The foot lands where the robot has it.
    landed = bench.footprints(FootprintKind.LANDED)
    for name, values in (("plan", [-1, -1, 0]), ("place", [-1, -1, 1]), ("foot", [0, 1, 1])):
        assert STEP_SCHEMA.column(landed, name).tolist() == values
    right = STEP_SCHEMA.column(landed, "position")[1:]
    np.testing.assert_allclose(right, 2 * [[goal.x - 0.1, goal.y, 0.0]], atol=1e-9)
    assert STEP_SCHEMA.column(landed, "landing_ns")[2] == 458 * MS


def test_a_foothold_gives_a_row_when_it_has_moved_by_more_than_5_mm(bench, robot):
    bench.clock.law = make_step_law(robot, Stance.of(robot))
    bench.disturbance[0] = 0.5
    goals = []
    for _ in range(150):
        bench.run(1)
        bench.disturbance[0] -= 0.004
        if bench.clock.chosen is not None:
            goals.append((bench.clock.chosen.x, bench.clock.chosen.y, bench.clock.chosen.z))
    places = STEP_SCHEMA.column(bench.footprints(FootprintKind.CHOSEN), "position")
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert 2 <= len(places) < len(set(goals))
    assert moved.min() > 5e-3
    assert math.dist(places[-1], goals[-1]) <= 5e-3
    assert STEP_SCHEMA.column(bench.footprints(FootprintKind.CHOSEN), "plan").tolist() == [
        -1.0
    ] * len(places)


def test_a_robot_that_begins_anew_stands_on_no_plan(bench, plan, robot, config):
    bench.clock.take(plan)
    bench.run(150)
    bench.clock = ContactClock(robot, config)
    bench.run(10)
    rows = bench.steps.rows()
    assert STEP_SCHEMA.column(rows, "kind").tolist() == [2, 2, 0, 2, 2]
    assert STEP_SCHEMA.column(rows, "plan").tolist() == [-1, -1, 0, -1, -1]


def test_the_com_stays_within_reach_of_feet_that_are_apart(robot):
    stance = Stance.of(robot)
    together = standing_footprints(robot)
    assert stance.level_within_reach(together, stance.rest_over(together)) == pytest.approx(0.0)
    ahead = dataclasses.replace(together[Foot.LEFT], x=together[Foot.LEFT].x + 0.2)
    feet = together | {Foot.LEFT: ahead}
    level = stance.level_within_reach(feet, stance.rest_over(feet))
    # Half of the step from each foot, on a circle of the standing height.
    height = stance.com_height
    assert level == pytest.approx(math.sqrt(height**2 - 0.1**2) - height)


def test_after_a_step_of_no_plan_the_com_comes_down_to_the_reach_of_the_legs(bench):
    for step in (0.0, 0.2):
        left = bench.clock.feet[Foot.LEFT]
        bench.clock.feet[Foot.LEFT] = dataclasses.replace(left, x=left.x + step)
        bench.clock._observe = lambda now: None
        height = bench.run(1000).com[2]
        lower = bench.clock.stance.level_within_reach(bench.clock.feet, bench._now.com[:2])
        standing = bench.clock.stance.com_height
        assert height - standing == pytest.approx(lower, abs=2e-3)
    assert lower < -0.005
