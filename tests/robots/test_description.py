from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.robots import CATALOGUE, Foot, load_robot
from shared.robots.description import robots_folder, sole_frame_name
from shared.robots.loading import MIN_SECOND_MOMENT
from shared.wbc.model import WholeBodyModel


@pytest.fixture(scope="module", params=list(CATALOGUE))
def any_robot(request):
    return load_robot(request.param)


@pytest.fixture(scope="module")
def soles(any_robot):
    return WholeBodyModel(any_robot).sole_placements(any_robot.q_standing)


def test_romeo_weighs_what_its_urdf_adds_up_to(robot):
    # Known to two decimals; 31 motors and a free base.
    assert robot.mass == pytest.approx(40.53, abs=0.005)
    assert (robot.model.nq, robot.model.nv) == (38, 37)
    assert robot.effort_limit.shape == (31,)
    assert np.all(robot.effort_limit > 0.0)


def test_talos_weighs_what_its_urdf_adds_up_to():
    talos = load_robot("talos")
    # Known to two decimals; 32 motors, two of them grippers, and a free base.
    assert talos.mass == pytest.approx(90.27, abs=0.005)
    assert (talos.model.nq, talos.model.nv) == (39, 38)


# What hip + knee + ankle do not add up to [rad]: rounding of the published posture to six decimals;
# both ankles of Talos are published rolled by this much, which its feet lay down at once.
TILT = {"romeo": 1e-6, "talos": 1.71e-3}


def test_standing_puts_both_soles_flat_on_the_ground(any_robot, soles):
    for placement in soles.values():
        # Sums of a dozen link offsets of order 0.1 m: rounding only. Both legs bend alike.
        assert placement.translation[2] == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(
            placement.rotation[2], [0.0, 0.0, 1.0], atol=TILT[any_robot.name]
        )


def test_standing_puts_the_base_above_the_origin(any_robot):
    np.testing.assert_array_equal(any_robot.q_standing[:2], [0.0, 0.0])
    assert any_robot.q_standing[2] > 0.5


@pytest.mark.parametrize(("name", "height"), [("romeo", 0.663), ("talos", 0.877)])
def test_the_centre_of_mass_stands_at_its_known_height(name, height):
    robot = load_robot(name)
    com = WholeBodyModel(robot).com_and_soles(robot.q_standing)[0]
    assert com[2] == pytest.approx(height, abs=1e-3)


def test_standing_keeps_the_centre_of_mass_over_the_feet(any_robot, soles):
    com = WholeBodyModel(any_robot).com_and_soles(any_robot.q_standing)[0]
    corners = np.vstack(
        [
            soles[foot.side].act(corner)
            for foot in any_robot.description.feet
            for corner in foot.corners()
        ]
    )
    assert np.all(corners[:, :2].min(axis=0) < com[:2])
    assert np.all(com[:2] < corners[:, :2].max(axis=0))


def test_the_left_foot_is_on_the_left(soles):
    assert soles[Foot.LEFT].translation[1] > 0.0 > soles[Foot.RIGHT].translation[1]


def test_soles_mirror_each_other(any_robot):
    left, right = any_robot.description.feet
    assert left.sole_x == right.sole_x
    assert left.sole_y == (-right.sole_y[1], -right.sole_y[0])


def test_a_margin_moves_every_corner_inwards(robot):
    foot = robot.description.feet[0]
    outer, inner = foot.corners(), foot.corners(0.005)
    centre = outer.mean(axis=0)
    np.testing.assert_allclose(np.abs(outer - inner)[:, :2], 0.005, rtol=1e-12)
    assert np.all(np.abs(inner - centre)[:, :2] < np.abs(outer - centre)[:, :2])


def test_the_sole_frame_lies_below_its_joint_with_the_same_axes(any_robot):
    model = any_robot.model
    for foot in any_robot.description.feet:
        frame = model.frames[model.getFrameId(sole_frame_name(foot.side))]
        assert model.names[frame.parentJoint] == foot.joint
        np.testing.assert_array_equal(frame.placement.translation, [0, 0, -foot.sole_height])
        np.testing.assert_array_equal(frame.placement.rotation, np.eye(3))


def test_every_body_can_exist(any_robot):
    for index in range(1, any_robot.model.njoints):
        moments = np.linalg.eigvalsh(any_robot.model.inertias[index].inertia)
        # ½ tr I − I_i ≥ 0 is the triangle inequality; half of the clamp covers its rounding.
        second_moments = 0.5 * moments.sum() - moments
        assert second_moments.min() > 0.5 * MIN_SECOND_MOMENT, any_robot.model.names[index]


def test_only_impossible_inertias_are_repaired(robot):
    urdf = robots_folder() / robot.description.urdf
    published = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    changed = [
        robot.model.names[k]
        for k in range(1, robot.model.njoints)
        if not np.array_equal(published.inertias[k].inertia, robot.model.inertias[k].inertia)
    ]
    # The two that MuJoCo refuses; even they keep their mass and lever.
    assert set(changed) == {"RShoulderYaw", "RElbowYaw"}
    for k in range(1, robot.model.njoints):
        assert published.inertias[k].mass == robot.model.inertias[k].mass
        np.testing.assert_array_equal(published.inertias[k].lever, robot.model.inertias[k].lever)
