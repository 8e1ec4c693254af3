"""Each term against its definition: finite differences of positions, and M a + h − Jᵀ w."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pinocchio as pin
import pytest

from shared.robots import Foot
from shared.robots.description import sole_frame_name
from shared.wbc.model import RowMultipliers, WholeBodyModel

# Central differences over ±1e-6 s: cancellation leaves 2e-10 of the value, measured. A wrong frame
# or sign is off by the whole of it.
STEP = 1e-6
DIFFERENCE_TOLERANCE = 1e-8
# The same sums in another order: 37 terms, cancelling forces of up to 1e4.
ROUNDING = 1e-11


def flow(robot, q, v, time):
    return pin.integrate(robot.model, q, time * v)


def close(actual, expected, tolerance):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance * scale)


def test_velocities_are_the_jacobians_times_v(model, states):
    for q, v in states:
        kinematics, jacobians = model.kinematics(q, v), model.jacobians(q)
        in_world = kinematics.world_from_base @ jacobians.J_com @ v
        close(kinematics.com_velocity, in_world, ROUNDING)
        for foot in Foot:
            close(kinematics.sole_velocity[foot], jacobians.J_sole[foot] @ v, ROUNDING)


def test_sole_velocity_is_the_rate_of_the_sole_placement_in_its_own_frame(model, robot, states):
    for q, v in states[:20]:
        before = model.sole_placements(flow(robot, q, v, -STEP))
        after = model.sole_placements(flow(robot, q, v, STEP))
        for foot in Foot:
            rate = pin.log6(before[foot].actInv(after[foot])).vector / (2 * STEP)
            close(model.kinematics(q, v).sole_velocity[foot], rate, DIFFERENCE_TOLERANCE)


def test_com_velocity_is_the_rate_of_the_com(model, robot, states):
    for q, v in states[:20]:
        before = model.com_and_soles(flow(robot, q, v, -STEP))[0]
        after = model.com_and_soles(flow(robot, q, v, STEP))[0]
        rate = (after - before) / (2 * STEP)
        close(model.kinematics(q, v).com_velocity, rate, DIFFERENCE_TOLERANCE)


def test_sole_acceleration_is_the_rate_of_the_sole_velocity_at_constant_v(model, robot, states):
    for q, v in states[:20]:
        before = WholeBodyModel(robot).kinematics(flow(robot, q, v, -STEP), v).sole_velocity
        after = WholeBodyModel(robot).kinematics(flow(robot, q, v, STEP), v).sole_velocity
        drift = model.kinematics(q, v).sole_acceleration
        for foot in Foot:
            rate = (after[foot] - before[foot]) / (2 * STEP)
            close(drift[foot], rate, DIFFERENCE_TOLERANCE)


def test_com_acceleration_is_the_rate_of_the_com_velocity_at_constant_v(model, robot, states):
    for q, v in states[:20]:
        before = model.kinematics(flow(robot, q, v, -STEP), v).com_velocity.copy()
        after = model.kinematics(flow(robot, q, v, STEP), v).com_velocity.copy()
        rate = (after - before) / (2 * STEP)
        close(model.kinematics(q, v).com_acceleration, rate, DIFFERENCE_TOLERANCE)


def test_drifts_vanish_at_rest(model, robot):
    kinematics = model.kinematics(robot.q_standing, np.zeros(model.nv))
    np.testing.assert_array_equal(kinematics.com_acceleration, 0.0)
    for foot in Foot:
        np.testing.assert_array_equal(kinematics.sole_acceleration[foot], 0.0)


def test_bias_force_at_rest_is_the_weight(model, robot):
    h = model.kinematics(robot.q_standing, np.zeros(model.nv)).force
    # The base stands upright: its vertical entry carries the whole robot.
    assert h[2] == pytest.approx(robot.mass * 9.81, rel=1e-12)
    np.testing.assert_allclose(h[:2], 0.0, atol=1e-9 * h[2])


def test_sole_acceleration_is_the_jacobian_times_a_plus_drift(model, states, rng):
    for q, v in states:
        a = rng.standard_normal(model.nv)
        kinematics, jacobians = model.kinematics(q, v), model.jacobians(q)
        for foot in Foot:
            expected = jacobians.J_sole[foot] @ a + kinematics.sole_acceleration[foot]
            velocity, acceleration = model.sole_motion(foot, q, v, a)
            close(velocity, jacobians.J_sole[foot] @ v, ROUNDING)
            close(acceleration, expected, ROUNDING)


def test_kinematics_at_an_acceleration_are_those_of_inverse_dynamics_and_of_the_rates(
    model, robot, states, rng
):
    other = WholeBodyModel(robot)
    for q, v in states:
        a = rng.standard_normal(model.nv)
        wrenches = {foot: 100.0 * rng.standard_normal(6) for foot in Foot}
        drift, now, jacobians = (
            other.kinematics(q, v),
            model.kinematics(q, v, a, wrenches),
            other.jacobians(q),
        )
        np.testing.assert_array_equal(now.force, other.inverse_dynamics(q, v, a, wrenches))
        in_world = now.world_from_base @ jacobians.J_com @ a
        close(now.com_acceleration, drift.com_acceleration + in_world, ROUNDING)
        for foot in Foot:
            expected = drift.sole_acceleration[foot] + jacobians.J_sole[foot] @ a
            close(now.sole_acceleration[foot], expected, ROUNDING)
        # Positions and velocities do not depend on it.
        close(now.com, drift.com, ROUNDING)
        close(now.com_velocity, drift.com_velocity, ROUNDING)
        np.testing.assert_array_equal(now.a, a)


@pytest.mark.parametrize("feet", [(), (Foot.LEFT,), (Foot.RIGHT,), (Foot.LEFT, Foot.RIGHT)])
def test_inverse_dynamics_adds_up_from_its_terms(model, robot, states, rng, feet):
    data = robot.model.createData()
    for q, v in states[:20]:
        a = rng.standard_normal(model.nv)
        wrenches = {foot: 100.0 * rng.standard_normal(6) for foot in feet}
        J = {foot: frame_jacobian(robot, data, q, foot) for foot in feet}
        expected = pin.crba(robot.model, data, q) @ a + model.kinematics(q, v).force
        for foot, wrench in wrenches.items():
            expected = expected - J[foot].T @ wrench
        close(model.inverse_dynamics(q, v, a, wrenches), expected, ROUNDING)


def test_a_foot_that_was_loaded_before_is_forgotten(model, states):
    (q, v), a = states[0], np.zeros(model.nv)
    unloaded = model.inverse_dynamics(q, v, a, {}).copy()
    model.inverse_dynamics(q, v, a, {Foot.LEFT: np.full(6, 50.0), Foot.RIGHT: np.full(6, 9.0)})
    np.testing.assert_array_equal(model.inverse_dynamics(q, v, a, {}), unloaded)


def test_unactuated_inertia_is_the_first_six_rows_of_the_symmetric_matrix(model, robot, states):
    data = robot.model.createData()
    for q, _ in states:
        M = pin.crba(robot.model, data, q)
        np.testing.assert_allclose(M, M.T, atol=1e-13 * np.abs(M).max())
        np.testing.assert_array_equal(model.jacobians(q).M_unactuated, M[:6])


def numbers(terms):
    """All arrays of some terms, in dictionaries too, without copying any."""
    for name in terms.__slots__:
        value = getattr(terms, name)
        for array in value.values() if isinstance(value, dict) else (value,):
            if isinstance(array, np.ndarray):
                yield array


def test_kinematics_are_those_of_the_last_call_whoever_holds_them(model, robot, states, rng):
    held = model.kinematics(*states[0])
    views = list(numbers(held))
    placements = [held.sole_placement(foot) for foot in Foot]
    a, wrenches = rng.standard_normal(model.nv), {Foot.LEFT: np.full(6, 5.0)}
    for how in ((), (a, wrenches), ()):
        now = model.kinematics(*states[3], *how)
        assert now is held
        expected = WholeBodyModel(robot).kinematics(*states[3], *how)
        for array, own in zip(numbers(now), numbers(expected), strict=True):
            np.testing.assert_array_equal(array, own)
    # Also what was taken from them before is of the last call, but for the measured state itself.
    for view, array in zip(views[2:], list(numbers(held))[2:], strict=True):
        assert np.shares_memory(view, array)
    for before, foot in zip(placements, Foot, strict=True):
        assert not before.isApprox(held.sole_placement(foot))


def test_all_of_the_workspace_is_named_live(model, states):
    # What the annotations promise to last is no view of Pinocchio's memory.
    kinematics, jacobians = model.kinematics(*states[0]), model.jacobians(states[0].q)
    com, soles = model.com_and_soles(states[0].q)
    motion = model.sole_motion(Foot.LEFT, *states[0], np.ones(model.nv))
    placements = model.sole_placements(states[0].q)
    multipliers = RowMultipliers.zero(model.nv)
    lasting = [
        *numbers(jacobians),
        com,
        *soles.values(),
        *motion,
        *(placement.translation for placement in placements.values()),
        model.transposed(states[0].q, multipliers),
        model.sole_motion_of_base(Foot.LEFT, kinematics, np.ones(6)),
    ]
    before = [array.copy() for array in lasting]
    model.kinematics(*states[3])
    model.jacobians(states[3].q)
    model.sole_placements(states[3].q)
    model.inverse_dynamics(*states[3], np.ones(model.nv), {Foot.LEFT: np.ones(6)})
    model.transposed(states[3].q, multipliers)
    model.sole_motion(Foot.LEFT, *states[3], np.ones(model.nv))
    model.com_and_soles(states[3].q)
    for array, copy in zip(lasting, before, strict=True):
        np.testing.assert_array_equal(array, copy)


def frame_jacobian(robot, data, q, foot):
    """Jacobian of a sole by Pinocchio's one-call function, not the one that the model uses."""
    frame = robot.model.getFrameId(sole_frame_name(foot))
    return pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL)


@pytest.mark.parametrize("name", ["com", "com_velocity", "com_acceleration", "world_from_base"])
def test_a_live_view_keeps_its_memory_alive(robot, states, name):
    model = WholeBodyModel(robot)
    data, view = model.data, getattr(model.kinematics(*states[3]), name)
    del model
    gc.collect()
    before = sys.getrefcount(data)
    del view
    assert sys.getrefcount(data) == before - 1


def test_kinematics_keep_the_memory_of_their_soles_alive(robot, states):
    model = WholeBodyModel(robot)
    data, now = model.data, model.kinematics(*states[3])
    del model
    gc.collect()
    before = sys.getrefcount(data)
    del now
    gc.collect()
    assert sys.getrefcount(data) < before - 4
