"""Forces, contact points and support polygon, in the world frame."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.motion.ground import Ground, Patch
from shared.robots import Robot
from shared.wbc.contacts import CORNER_MARGIN, ContactMode
from viewer.pose import PoseModel, closed_hull

# Kinematics in float64 on lengths of about a metre and forces of about 100 N.
EXACT = 1e-9
FRICTION = 0.5


@pytest.fixture
def pose(robot: Robot) -> PoseModel:
    return PoseModel(robot, [1], friction=FRICTION)


def turned(robot: Robot, *, yaw: float) -> np.ndarray:
    """The standing configuration turned about the vertical, base kept where it is."""
    q = robot.q_standing.copy()
    turn = pin.Quaternion(pin.utils.rpyToMatrix(0.0, 0.0, yaw))
    q[3:7] = (turn * pin.Quaternion(q[3:7])).coeffs()
    return q


def test_standing_contact_points_are_the_shrunk_corners_of_both_soles_on_the_ground(
    robot: Robot, pose: PoseModel
) -> None:
    points = pose.frame(robot.q_standing, np.zeros(24), ContactMode.DOUBLE_SUPPORT).contact_points
    assert points.shape == (8, 3)
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-6)
    left = robot.soles[0]
    length = left.x[1] - left.x[0] - 2 * CORNER_MARGIN
    width = left.y[1] - left.y[0] - 2 * CORNER_MARGIN
    assert np.ptp(points[:4, 0]) == pytest.approx(length, abs=1e-6)
    assert np.ptp(points[:4, 1]) == pytest.approx(width, abs=1e-6)
    assert points[:4, 1].min() > points[4:, 1].max(), "left foot first, on the positive side"


def test_a_force_along_the_sole_turns_with_the_robot(robot: Robot, pose: PoseModel) -> None:
    f = np.tile([10.0, 0.0, 50.0], 8)
    quarter_turn = turned(robot, yaw=np.pi / 2)
    forces = pose.frame(quarter_turn, f, ContactMode.DOUBLE_SUPPORT).contact_forces
    # The soles of this posture are level and point forward to 1e-6 rad.
    np.testing.assert_allclose(forces, np.tile([0.0, 10.0, 50.0], (8, 1)), atol=1e-3)


def test_forces_and_points_have_the_wrench_that_the_sole_frames_give(
    robot: Robot, pose: PoseModel, rng: np.random.Generator
) -> None:
    q = pin.integrate(robot.model, robot.q_standing, rng.normal(scale=0.2, size=robot.model.nv))
    f = rng.normal(scale=50.0, size=24)
    frame = pose.frame(q, f, ContactMode.DOUBLE_SUPPORT)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    total = pin.Force.Zero()
    for k, foot in enumerate(robot.soles):
        sole = data.oMf[robot.model.getFrameId(f"{foot.side.value}_sole_frame")]
        for corner, force in zip(foot.corners(CORNER_MARGIN), f.reshape(2, 4, 3)[k], strict=True):
            total += sole.act(pin.Force(force, np.cross(corner, force)))
    np.testing.assert_allclose(frame.contact_forces.sum(axis=0), total.linear, atol=EXACT)
    moment = np.cross(frame.contact_points, frame.contact_forces).sum(axis=0)
    np.testing.assert_allclose(moment, total.angular, atol=EXACT)


@pytest.mark.parametrize(
    ("mode", "rows"),
    [(ContactMode.LEFT_SUPPORT, slice(0, 4)), (ContactMode.RIGHT_SUPPORT, slice(4, 8))],
)
def test_in_single_support_only_the_support_foot_has_forces(
    robot: Robot, pose: PoseModel, mode: ContactMode, rows: slice
) -> None:
    f = np.full((8, 3), 99.0)
    f[rows] = np.arange(12.0).reshape(4, 3)
    single = pose.frame(robot.q_standing, f, mode)
    both = pose.frame(robot.q_standing, np.zeros(24), ContactMode.DOUBLE_SUPPORT)
    assert single.contact_forces.shape == (4, 3)
    np.testing.assert_allclose(single.contact_points, both.contact_points[rows])
    np.testing.assert_allclose(np.linalg.norm(single.contact_forces), np.linalg.norm(f[rows]))


def test_the_support_polygon_lies_on_the_ground_around_all_contact_points(
    robot: Robot, pose: PoseModel
) -> None:
    frame = pose.frame(robot.q_standing, np.zeros(24), ContactMode.DOUBLE_SUPPORT)
    polygon = frame.support_polygon
    np.testing.assert_array_equal(polygon[0], polygon[-1])
    np.testing.assert_array_equal(polygon[:, 2], 0.0)
    edges = np.diff(polygon[:, :2], axis=0)
    for start, (dx, dy) in zip(polygon[:-1, :2], edges, strict=True):
        outside = dx * (frame.contact_points[:, 1] - start[1]) - dy * (
            frame.contact_points[:, 0] - start[0]
        )
        assert (outside >= -EXACT).all()


def test_on_a_stair_the_polygon_and_the_centre_of_pressure_are_on_it(robot: Robot) -> None:
    stair = Ground((Patch((-1.0, 1.0), (-1.0, 1.0), 0.06),))
    pose = PoseModel(robot, [1], friction=FRICTION, ground=stair)
    f = np.tile((0.0, 0.0, 50.0), 8)
    q = robot.q_standing.copy()
    q[2] += 0.06
    frame = pose.frame(q, f, ContactMode.DOUBLE_SUPPORT)
    np.testing.assert_array_equal(frame.support_polygon[:, 2], 0.06)
    np.testing.assert_allclose(frame.contact_points[:, 2], 0.06, atol=1e-6)
    assert frame.centre_of_pressure[2] == 0.06


def test_the_hull_leaves_inner_and_repeated_points_out() -> None:
    square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    hull = closed_hull(np.array([*square, [0.5, 0.5], [0.5, 0.0], [1.0, 1.0]]))
    np.testing.assert_array_equal(hull, [*square, square[0]])


def test_joint_placements_are_those_of_the_kinematics(robot: Robot) -> None:
    joints = [1, robot.model.njoints - 1]
    q = turned(robot, yaw=0.3)
    placements = PoseModel(robot, joints, friction=FRICTION).joints(q)
    np.testing.assert_allclose(placements.translation[0], q[:3], atol=EXACT)
    np.testing.assert_allclose(np.abs(placements.quat_xyzw[0] @ q[3:7]), 1.0, atol=EXACT)
    assert placements.translation.shape == (2, 3)


def test_friction_used_is_one_on_the_pyramid_and_nothing_at_points_that_carry_nothing(
    robot: Robot, pose: PoseModel
) -> None:
    f = np.tile([0.0, 0.0, 40.0], (8, 1))
    f[0] = [20.0, 5.0, 40.0]
    f[1] = [0.0, -10.0, 40.0]
    f[2] = [1.0, 0.0, 1.0]
    f[3] = [0.0, 30.0, -20.0]
    quarter_turn = turned(robot, yaw=np.pi / 2)
    frame = pose.frame(quarter_turn, f.ravel(), ContactMode.DOUBLE_SUPPORT)
    np.testing.assert_allclose(frame.friction_used[:3], [1.0, 0.5, 0.0])
    assert frame.friction_used[3] > 1.0, "a sole that pulls is beyond every friction"


def test_a_force_at_its_limit_ends_on_the_rim_of_its_pyramid(robot: Robot, pose: PoseModel) -> None:
    f = np.tile([20.0, 20.0, 40.0], 8)
    tilted = robot.q_standing.copy()
    tilted[3:7] = pin.Quaternion(pin.utils.rpyToMatrix(0.2, -0.3, 0.7)).coeffs()
    frame = pose.frame(tilted, f, ContactMode.DOUBLE_SUPPORT)
    np.testing.assert_allclose(frame.friction_edges[:, 0], frame.contact_forces, atol=EXACT)


def test_the_centre_of_pressure_is_under_the_load(robot: Robot, pose: PoseModel) -> None:
    f = np.zeros((8, 3))
    f[5, 2] = 200.0
    frame = pose.frame(robot.q_standing, f.ravel(), ContactMode.DOUBLE_SUPPORT)
    under = [*frame.contact_points[5, :2], 0.0]
    # The soles of this posture are level to 1e-6 rad.
    np.testing.assert_allclose(frame.centre_of_pressure, under, atol=1e-5)
    unloaded = pose.frame(robot.q_standing, np.zeros(24), ContactMode.DOUBLE_SUPPORT)
    assert np.isnan(unloaded.centre_of_pressure).all()
