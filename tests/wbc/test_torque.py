from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.wbc.contacts import ContactMode
from shared.wbc.projector import solve
from shared.wbc.qp import DaqpSolver
from shared.wbc.torque import recover_torque
from tests.wbc.test_model import frame_jacobian

MODES = list(ContactMode)


@pytest.fixture(params=MODES, ids=lambda mode: mode.name)
def stack(request, stacks):
    return stacks[request.param]


def contact_force(robot, stack, data, q, f):
    """J_cᵀ G f, (nv,), from its definition."""
    wrenches = stack.contacts.wrenches(f)
    return sum(frame_jacobian(robot, data, q, foot).T @ w for foot, w in wrenches.items())


def test_torque_is_the_actuated_part_of_the_equation_of_motion(model, robot, stack, states, rng):
    data = robot.model.createData()
    for q, v in states:
        y = 30.0 * rng.standard_normal(stack.layout.n_unknowns)
        a, f = y[: model.nv], y[model.nv :]
        expected = (
            pin.crba(robot.model, data, q) @ a
            + pin.nonLinearEffects(robot.model, data, q, v)
            - contact_force(robot, stack, data, q, f)
        )
        tau = recover_torque(model, stack.contacts, q, v, y)
        # The same sums in another order, relative to the largest generalised force.
        np.testing.assert_allclose(tau, expected[6:], atol=1e-11 * np.abs(expected).max())


def test_forward_dynamics_under_the_torque_gives_the_acceleration_back(
    model, robot, stack, states, reference
):
    data = robot.model.createData()
    for q, v in states:
        kinematics = model.kinematics(q, v)
        b = stack.right_hand_side(kinematics, reference)
        matrices = stack.matrices(model.jacobians(q))
        y = solve(stack, matrices, b, solver=DaqpSolver()).projector.apply(b)
        tau = recover_torque(model, stack.contacts, q, v, y)
        force = contact_force(robot, stack, data, q, y[model.nv :])
        a = pin.aba(robot.model, data, q, v, np.concatenate([np.zeros(6), tau]) + force)
        # The base has no motor: this holds only because the QP's dynamics rows do. Measured 5e-13.
        np.testing.assert_allclose(a, y[: model.nv], atol=1e-10 * np.abs(y).max())


def test_torque_is_a_copy_that_a_later_call_does_not_change(model, stack, states, rng):
    (q, v), y = states[0], rng.standard_normal(stack.layout.n_unknowns)
    tau = recover_torque(model, stack.contacts, q, v, y)
    before = tau.copy()
    recover_torque(model, stack.contacts, states[3].q, states[3].v, 2.0 * y)
    np.testing.assert_array_equal(tau, before)
    assert tau.shape == (31,)
