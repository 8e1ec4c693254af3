"""The plan of a robot in a stand whose base's estimate drifts."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from robot_node.plan_anchor import PlanAnchor
from shared.motion.plan_frame import PlanFrame
from shared.motion.standing import Standing

MS = 1_000_000
# Larger than what a robot in a stand may be off by [m].
NEAR = 0.09


class Walk(Standing):
    """A stand that counts as a walk until 1.5 s."""

    def next_switch(self, time_ns):
        return 1500 * MS if time_ns < 1500 * MS else None


def noisy(robot, rng):
    q = robot.q_standing.copy()
    q[7:] += 0.01 * rng.standard_normal(len(q) - 7)
    return q


def stand(anchor, robot, ticks, *, estimate, motion=None):
    """Show the anchor a stand. Yield each measured q in the plan, and the true one."""
    rng, motion = np.random.default_rng(0), motion or Standing(robot)
    for tick in range(ticks):
        q = noisy(robot, rng)
        in_plan = anchor.frame.in_plan(estimate(q, tick * 1e-3))
        anchor.stand(in_plan, motion, time_ns=tick * MS)
        yield in_plan, q


@pytest.fixture
def anchor(model):
    return PlanAnchor(model)


@pytest.mark.parametrize("speed", [PlanFrame(0.05), PlanFrame(0.0, -0.1), PlanFrame(z=0.05)])
def test_the_plan_goes_along_with_a_drift(anchor, robot, speed):
    def estimate(q, seconds):
        seconds = max(0.0, seconds - 0.5)
        return PlanFrame(speed.x * seconds, speed.y * seconds, 0.3, speed.z * seconds).in_world(q)

    begun = PlanFrame(yaw=0.3).in_world(robot.q_standing)
    for in_plan, _ in stand(anchor, robot, 5000, estimate=estimate):
        np.testing.assert_allclose(in_plan[:3], begun[:3], atol=NEAR)
    assert anchor.drifts > 3


def test_the_plan_turns_along_with_a_drift_of_the_heading(anchor, robot):
    for in_plan, q in stand(
        anchor, robot, 5000, estimate=lambda q, seconds: PlanFrame(yaw=0.1 * seconds).in_world(q)
    ):
        angle = pin.Quaternion(in_plan[3:7]).angularDistance(pin.Quaternion(q[3:7]))
        assert angle < 0.2
    assert anchor.drifts == 2


def test_noise_leaves_the_plan_where_it_is(anchor, robot):
    for _ in stand(anchor, robot, 20_000, estimate=lambda q, seconds: q):
        pass
    assert anchor.frame == PlanFrame()


def test_a_robot_that_tips_or_moves_a_foot_does_not_move_the_plan(anchor, robot):
    def tips(q, seconds):
        q = q.copy()
        if seconds > 0.5:
            q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, 0.15, 0.0]))).coeffs()
            q[0] += 0.1
        return q

    def moves_a_foot(q, seconds):
        q = q.copy()
        hip = robot.model.joints[robot.model.getJointId("LHipPitch")].idx_q
        q[hip] -= 0.2 * (seconds > 0.5)
        return q

    for estimate in (tips, moves_a_foot):
        for _ in stand(anchor, robot, 2000, estimate=estimate):
            pass
    assert anchor.frame == PlanFrame()


def test_a_walk_is_no_stand_until_its_last_contact_switch(anchor, robot):
    def estimate(q, seconds):
        return PlanFrame(0.1).in_world(q) if seconds > 1.0 else q

    for _ in stand(anchor, robot, 4000, estimate=estimate, motion=Walk(robot)):
        pass
    assert anchor.frame == PlanFrame()


def test_a_joint_hold_keeps_the_height_to_which_the_estimate_has_drifted(anchor, robot):
    motion = Standing(robot)

    def estimate(q, seconds):
        return PlanFrame(z=0.1).in_world(q) if seconds > 0.5 else q

    for _ in stand(anchor, robot, 2000, estimate=estimate):
        pass
    # The average over 0.1 s has not forgotten the old height.
    assert anchor.frame.z == pytest.approx(0.1, abs=0.01)
    for tick in range(200):
        q = PlanFrame(0.2, z=0.1).in_world(robot.q_standing)
        anchor.hold(q, motion, time_ns=(2000 + tick) * MS, period_ns=MS)
    assert anchor.frame.x == pytest.approx(0.2, abs=1e-6)
    assert anchor.frame.z == pytest.approx(0.1, abs=0.01)
