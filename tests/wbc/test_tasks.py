from __future__ import annotations

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest

from shared.robots import Foot
from shared.wbc.model import RowMultipliers
from shared.wbc.tasks import (
    AngularMomentumTask,
    BaseOrientationTask,
    ComTask,
    CopTask,
    PostureTask,
    SwingFootTask,
)

KP = 7.0
KD = 2.0 * math.sqrt(KP)  # critical damping
# One rotation, or sums over 32 bodies: rounding of numbers of order one.
ROUNDING = 1e-12


@pytest.fixture(params=["com", "base_orientation", "posture"])
def task(request, model):
    if request.param == "com":
        return ComTask(weight=1.0, kp=KP)
    cls = {"base_orientation": BaseOrientationTask, "posture": PostureTask}[request.param]
    return cls(weight=1.0, kp=KP, nv=model.nv)


def target_of(task, kinematics, reference):
    """s̈* − J̇ v − J a, (size,), without the weight that the task gives its rows."""
    rows = np.full(task.size, np.nan)
    task.write_target(rows, kinematics, reference)
    return rows / math.sqrt(task.weight)


def displaced(robot, **coordinates):
    """Standing, with entries of the tangent space moved: `base` (6,) or `joints` (nv − 6,)."""
    step = np.zeros(robot.model.nv)
    step[:6] = coordinates.get("base", 0.0)
    step[6:] = coordinates.get("joints", 0.0)
    return pin.integrate(robot.model, robot.q_standing, step)


def test_target_is_zero_at_the_reference_at_rest(task, model, robot, reference):
    kinematics = model.kinematics(robot.q_standing, np.zeros(model.nv))
    target = target_of(task, kinematics, reference)
    assert target.shape == (task.size,)
    np.testing.assert_allclose(target, 0.0, atol=ROUNDING)


def test_rows_have_the_root_of_the_weight(model, states, reference):
    for make in (
        lambda weight: ComTask(weight=weight, kp=KP),
        lambda weight: BaseOrientationTask(weight=weight, kp=KP, nv=model.nv),
        lambda weight: PostureTask(weight=weight, kp=KP, nv=model.nv),
    ):
        one, nine = make(1.0), make(9.0)
        kinematics = model.kinematics(*states[3])
        rows, weighted = np.empty((2, one.size))
        one.write_target(rows, kinematics, reference)
        nine.write_target(weighted, kinematics, reference)
        np.testing.assert_allclose(weighted, 3.0 * rows, rtol=1e-13, atol=1e-13)


def test_jacobian_has_a_row_per_target_and_a_column_per_acceleration(task, model, robot):
    assert task.jacobian(model.jacobians(robot.q_standing)).shape == (task.size, model.nv)


def test_a_displaced_centre_of_mass_is_called_back(model, robot, reference):
    offset = np.array([0.01, -0.02, 0.03])
    q = displaced(robot, base=np.append(offset, np.zeros(3)))
    target = target_of(
        ComTask(weight=1.0, kp=KP), model.kinematics(q, np.zeros(model.nv)), reference
    )
    np.testing.assert_allclose(target, -KP * offset, atol=ROUNDING)


def test_a_moving_centre_of_mass_is_braked_critically(model, robot, reference):
    v = np.zeros(model.nv)
    v[:3] = [0.1, 0.2, -0.3]
    kinematics = model.kinematics(robot.q_standing, v)
    target = target_of(ComTask(weight=1.0, kp=KP), kinematics, reference)
    np.testing.assert_allclose(target, -KD * kinematics.com_velocity, atol=ROUNDING)


def test_the_reference_motion_of_the_centre_of_mass_is_followed(model, robot, reference):
    moving = dataclasses.replace(
        reference,
        com=reference.com + np.array([0.0, 0.1, 0.0]),
        com_velocity=np.array([0.0, 0.0, 0.2]),
        com_acceleration=np.array([0.3, 0.0, 0.0]),
    )
    kinematics = model.kinematics(robot.q_standing, np.zeros(model.nv))
    target = target_of(ComTask(weight=1.0, kp=KP), kinematics, moving)
    np.testing.assert_allclose(target, [0.3, KP * 0.1, KD * 0.2], atol=ROUNDING)


def test_the_drift_of_the_centre_of_mass_is_subtracted(model, states, reference):
    task = ComTask(weight=1.0, kp=KP)
    for q, v in states[:10]:
        kinematics = model.kinematics(q, v)
        expected = (
            KP * (reference.com - kinematics.com)
            - KD * kinematics.com_velocity
            - kinematics.com_acceleration
        )
        in_world = kinematics.world_from_base @ target_of(task, kinematics, reference)
        np.testing.assert_allclose(in_world, expected, rtol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_a_tilted_base_is_turned_back_about_its_own_axis(model, robot, reference, axis):
    tilt = np.zeros(6)
    tilt[3 + axis] = 0.4
    kinematics = model.kinematics(displaced(robot, base=tilt), np.zeros(model.nv))
    task = BaseOrientationTask(weight=1.0, kp=KP, nv=model.nv)
    np.testing.assert_allclose(target_of(task, kinematics, reference), -KP * tilt[3:], atol=1e-9)


def test_turning_along_the_target_brings_any_base_closer(model, states, reference):
    task = BaseOrientationTask(weight=1.0, kp=1.0, nv=model.nv)
    # A reference that is turned itself, or base and world frame would not be told apart.
    turned = dataclasses.replace(reference, world_from_base=pin.exp3(np.array([0.3, -0.5, 0.7])))

    def angle(rotation):
        return np.linalg.norm(pin.log3(rotation.T @ turned.world_from_base))

    for q, _ in states:
        kinematics = model.kinematics(q, np.zeros(model.nv))
        target = target_of(task, kinematics, turned)
        closer = kinematics.world_from_base @ pin.exp3(0.1 * target)
        # A geodesic: a tenth of the way leaves nine tenths of the angle.
        assert angle(closer) == pytest.approx(0.9 * angle(kinematics.world_from_base), rel=1e-6)


def test_a_turning_base_is_braked_critically(model, robot, reference):
    v = np.zeros(model.nv)
    v[3:6] = [0.1, 0.2, -0.3]
    task = BaseOrientationTask(weight=1.0, kp=KP, nv=model.nv)
    target = target_of(task, model.kinematics(robot.q_standing, v), reference)
    np.testing.assert_allclose(target, -KD * v[3:6], atol=ROUNDING)


def test_displaced_and_moving_joints_are_called_back_and_braked(model, robot, reference, rng):
    offset, v = 0.1 * rng.standard_normal(31), rng.standard_normal(model.nv)
    task = PostureTask(weight=1.0, kp=KP, nv=model.nv)
    kinematics = model.kinematics(displaced(robot, joints=offset), v)
    target = target_of(task, kinematics, reference)
    np.testing.assert_allclose(target, -KP * offset - KD * v[6:], rtol=1e-12)


def test_jacobians_of_orientation_and_posture_pick_their_velocities(model, states):
    orientation = BaseOrientationTask(weight=1.0, kp=KP, nv=model.nv)
    posture = PostureTask(weight=1.0, kp=KP, nv=model.nv)
    q, v = states[0]
    jacobians = model.jacobians(q)
    np.testing.assert_array_equal(orientation.jacobian(jacobians) @ v, v[3:6])
    np.testing.assert_array_equal(posture.jacobian(jacobians) @ v, v[6:])


def test_the_rate_of_the_angular_momentum_is_its_row_times_the_acceleration(
    model, states, reference, rng
):
    """Against differences of Pinocchio's centroidal momentum along the motion."""
    task, data, step = AngularMomentumTask(weight=1.0, kp=KP), model.model.createData(), 1e-5

    def momentum(q, v):
        return pin.computeCentroidalMomentum(model.model, data, q, v).angular.copy()

    for q, v in states[:12]:
        a = rng.standard_normal(model.nv)
        J = task.jacobian(model.jacobians(q))
        turned = pin.Quaternion(q[3:7]).matrix()
        np.testing.assert_allclose(turned @ (J @ v), momentum(q, v), atol=1e-10)
        ahead, behind = (
            momentum(pin.integrate(model.model, q, t * v + 0.5 * t * abs(t) * a), v + t * a)
            for t in (step, -step)
        )
        rate = (ahead - behind) / (2.0 * step)
        scale = max(1.0, np.abs(rate).max())
        target = target_of(task, model.kinematics(q, v), reference)
        asked = turned @ (J @ a - target)  # L̇ + kp L
        np.testing.assert_allclose(asked, rate + KP * momentum(q, v), atol=1e-5 * scale)
        # At a solution the row is what is left of it.
        still = {foot: np.zeros(6) for foot in Foot}
        left = target_of(task, model.kinematics(q, v, a, still), reference)
        np.testing.assert_allclose(left, target - J @ a, atol=1e-9 * scale)


def test_multipliers_of_a_task_are_added_to_those_that_are_there(task, model, states, rng):
    swing = SwingFootTask(weight=1.0, kp=KP, foot=Foot.LEFT)
    turn = AngularMomentumTask(weight=1.0, kp=KP)
    cop = CopTask(weight=1.0, mass=model.robot.mass, foot=Foot.RIGHT)
    for each in (task, swing, turn, cop):
        multipliers = RowMultipliers.zero(model.nv)
        first, second = rng.standard_normal((2, each.size))
        q, v = states[2]
        kinematics = model.kinematics(q, v)
        each.add_transposed(first, multipliers, kinematics)
        each.add_transposed(second, multipliers, kinematics)
        expected = each.jacobian(model.jacobians(q)).T @ (first + second)
        np.testing.assert_allclose(model.transposed(q, multipliers), expected, atol=1e-10)
