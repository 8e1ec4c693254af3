from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.robots import CATALOGUE, description_of, load_robot
from shared.robots.loading import MIN_SECOND_MOMENT, STANDING_CHECKS, URDF_CHECKS, checks
from shared.wbc.model import WholeBodyModel


@pytest.fixture(scope="module", params=list(CATALOGUE))
def any_robot(request):
    return load_robot(request.param)


def test_romeo_weighs_what_its_urdf_adds_up_to(robot):
    # Known to two decimals; 31 motors and a free base.
    assert robot.mass == pytest.approx(40.53, abs=0.005)
    assert (robot.model.nq, robot.model.nv) == (38, 37)
    assert robot.effort_limit.shape == (31,)
    assert np.all(robot.effort_limit > 0.0)


@pytest.mark.parametrize(("name", "mass", "motors"), [("g1", 33.34, 29), ("icub", 28.35, 29)])
def test_g1_and_icub_weigh_what_their_urdfs_add_up_to(name, mass, motors):
    robot = load_robot(name)
    assert robot.mass == pytest.approx(mass, abs=0.005)
    assert len(robot.effort_limit) == motors


def test_talos_weighs_what_its_urdf_adds_up_to():
    talos = load_robot("talos")
    # Known to two decimals; 32 motors, two of them grippers, and a free base.
    assert talos.mass == pytest.approx(90.27, abs=0.005)
    assert (talos.model.nq, talos.model.nv) == (39, 38)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_robot_of_the_catalogue_passes_every_check(name):
    found = dict(checks(description_of(name)))
    assert len(found) == len(URDF_CHECKS) + len(STANDING_CHECKS)
    assert not any(found.values())


def test_standing_puts_the_base_above_the_origin(any_robot):
    np.testing.assert_array_equal(any_robot.q_standing[:2], [0.0, 0.0])
    assert any_robot.q_standing[2] > 0.4


@pytest.mark.parametrize(
    ("name", "height"), [("romeo", 0.663), ("talos", 0.877), ("g1", 0.669), ("icub", 0.453)]
)
def test_the_centre_of_mass_stands_at_its_known_height(name, height):
    robot = load_robot(name)
    com = WholeBodyModel(robot).com_and_soles(robot.q_standing)[0]
    assert com[2] == pytest.approx(height, abs=1e-3)


def test_soles_mirror_each_other(any_robot):
    left, right = any_robot.soles
    assert left.x == right.x
    assert left.y == (-right.y[1], -right.y[0])


def test_a_margin_moves_every_corner_inwards(robot):
    foot = robot.soles[0]
    outer, inner = foot.corners(), foot.corners(0.005)
    centre = outer.mean(axis=0)
    np.testing.assert_allclose(np.abs(outer - inner)[:, :2], 0.005, rtol=1e-12)
    assert np.all(np.abs(inner - centre)[:, :2] < np.abs(outer - centre)[:, :2])


def test_a_sole_frame_lies_on_the_ground_with_the_axes_of_the_robot(any_robot):
    soles = WholeBodyModel(any_robot).sole_placements(any_robot.q_standing).values()
    assert min(each.translation[2] for each in soles) == pytest.approx(0.0, abs=1e-12)
    for placement in soles:
        # Rounding of published postures to six decimals, and Talos' ankles, 1.7 mrad.
        np.testing.assert_allclose(placement.rotation[2], [0.0, 0.0, 1.0], atol=2e-2)
        # The legs of iCub differ by 1 µm, and its knees are bent by rounded angles.
        assert placement.translation[2] == pytest.approx(0.0, abs=1e-5)


def test_every_body_can_exist(any_robot):
    for index in range(1, any_robot.model.njoints):
        moments = np.linalg.eigvalsh(any_robot.model.inertias[index].inertia)
        # ½ tr I − I_i ≥ 0 is the triangle inequality; half of the clamp covers its rounding.
        second_moments = 0.5 * moments.sum() - moments
        assert second_moments.min() > 0.5 * MIN_SECOND_MOMENT, any_robot.model.names[index]


def test_only_impossible_inertias_are_repaired(robot):
    published = pin.buildModelFromUrdf(str(robot.description.urdf), pin.JointModelFreeFlyer())
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
