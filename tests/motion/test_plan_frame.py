"""The plan's frame: states into it, references out of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.motion.plan_frame import PlanFrame

FRAME = PlanFrame(0.3, -0.7, 2.5, 0.2)


def test_a_frame_at_the_origin_changes_nothing(robot):
    assert PlanFrame().in_plan(robot.q_standing) is robot.q_standing
    assert PlanFrame().in_world(robot.q_standing) is robot.q_standing


def test_a_configuration_in_the_plan_is_the_same_one_seen_from_there(robot, states):
    world_from_plan = pin.SE3(
        pin.utils.rotate("z", FRAME.yaw), np.array([FRAME.x, FRAME.y, FRAME.z])
    )
    for state in states:
        q = state.q
        in_plan = FRAME.in_plan(q)
        np.testing.assert_array_equal(in_plan[7:], q[7:])
        base = pin.XYZQUATToSE3(q[:7])
        assert base.isApprox(world_from_plan * pin.XYZQUATToSE3(in_plan[:7]), 1e-12)
        np.testing.assert_allclose(FRAME.in_world(in_plan), q, atol=1e-12)


def test_a_point_of_the_plan_goes_where_the_robot_goes(robot, model):
    com, _ = model.com_and_soles(robot.q_standing)
    moved, _ = model.com_and_soles(FRAME.in_world(robot.q_standing))
    np.testing.assert_allclose(FRAME.point_in_world(com), moved, atol=1e-12)


def test_the_frame_between_two_poses_takes_the_one_to_the_other():
    in_plan = PlanFrame(1.0, 2.0, -3.0, 0.1)
    frame = PlanFrame.between(PlanFrame(-0.5, 0.25, 3.0, 0.4), in_plan)
    point = frame.point_in_world(np.array([in_plan.x, in_plan.y, in_plan.z]))
    np.testing.assert_allclose(point, [-0.5, 0.25, 0.4], atol=1e-12)
    # Six radians are a quarter of a radian the other way.
    assert frame.yaw == pytest.approx(6.0 - 2.0 * np.pi)


def test_a_frame_in_a_moved_plan_takes_a_point_where_both_take_it():
    inner = PlanFrame(-1.0, 0.2, 2.0, 0.1)
    point = np.array([0.1, 0.2, 0.3])
    moved = FRAME.followed_by(inner).point_in_world(point)
    np.testing.assert_allclose(moved, FRAME.point_in_world(inner.point_in_world(point)), atol=1e-12)
    # From 4.5 rad the other way.
    assert FRAME.followed_by(inner).yaw == pytest.approx(4.5 - 2.0 * np.pi)
