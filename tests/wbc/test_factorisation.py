"""What the edge sends: blocks of the inverse of the KKT matrix; and the products and residuals by
which the robot corrects with them, without forming a row.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.robots import Foot
from shared.wbc.correction import Iterate
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.model import RowMultipliers
from shared.wbc.whole_body import WholeBodyController
from tests.wbc.correction_bench import DOUBLE, LEFT, RIGHT, TURNS, moved, relative

# ---- the factorisation


def test_the_blocks_are_the_inverse_of_the_kkt_matrix(bench, states):
    for state in states:
        problem, blocks = bench.problem(state), bench.factorise(state.q)
        n_e = len(problem.e)
        matrix = np.block([[problem.H, -problem.E.T], [problem.E, np.zeros((n_e, n_e))]])
        inverse = np.block([[blocks.P, blocks.Q], [-blocks.Q.T, blocks.T]])
        # Entries of the inverse reach 1 / ω_f = 1e5: rounding of 7e-9 measured.
        np.testing.assert_allclose(matrix @ inverse, np.eye(len(matrix)), atol=1e-7)


def test_damping_adds_to_the_diagonal_of_the_tasks_hessian(bench, states):
    damping = 0.05
    n_a = bench.model.nv
    for state in states[:20]:
        problem, blocks = bench.problem(state), bench.factorise(state.q, damping=damping)
        H, E = problem.H.copy(), problem.E
        H[:n_a, :n_a] += damping * np.eye(n_a)
        matrix = np.block([[H, -E.T], [E, np.zeros((len(E), len(E)))]])
        inverse = np.block([[blocks.P, blocks.Q], [-blocks.Q.T, blocks.T]])
        np.testing.assert_allclose(matrix @ inverse, np.eye(len(matrix)), atol=1e-7)
        # The rows of the tasks are what they are.
        np.testing.assert_array_equal(blocks.A, bench.factorise(state.q).A)


def test_the_blocks_of_which_one_triangle_is_sent_are_symmetric(bench, states):
    for state in states[:20]:
        blocks = bench.factorise(state.q)
        for block in (blocks.P, blocks.T):
            assert relative(block - block.T, block) < 1e-14


def test_a_factorisation_names_its_mode_and_posture(bench, states):
    blocks = bench.factorise(states[3].q)
    assert blocks.mode is bench.stack.mode
    np.testing.assert_array_equal(blocks.posture, states[3].q[7:])


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_nothing_of_it_depends_on_where_the_base_is_or_how_it_is_turned(bench, states, rng, turn):
    for state in states[:20]:
        here = bench.factorise(state.q)
        there = bench.factorise(moved(state.q, turn, rng.uniform(-10.0, 10.0, 3)))
        for name in ("P", "Q", "T", "A"):
            block = getattr(here, name)
            assert relative(getattr(there, name) - block, block) < 1e-9, name


def test_dependent_rows_cannot_be_factorised(bench, states):
    matrices = bench.matrices(states[0].q)
    contact_without_row, joint_without_task = matrices.E_a.copy(), matrices.A.copy()
    contact_without_row[7] = 0.0
    joint_without_task[:, 12] = 0.0
    for changed in ({"E_a": contact_without_row}, {"A": joint_without_task}):
        with pytest.raises(np.linalg.LinAlgError):
            factorise_kkt(bench.stack, dataclasses.replace(matrices, **changed), states[0].q[7:])


def test_the_controller_gives_the_modes_asked_for_or_none_of_them(
    robot, config, motion, model, stacks, states
):
    controller = WholeBodyController(robot, config, motion)
    q = states[0].q
    made = controller.factorise(q, (LEFT, DOUBLE), damping=0.05)
    assert [each.mode for each in made] == [LEFT, DOUBLE]
    for each in made:
        matrices = stacks[each.mode].matrices(model.jacobians(q))
        expected = factorise_kkt(stacks[each.mode], matrices, q[7:], damping=0.05)
        np.testing.assert_array_equal(each.P, expected.P)
    assert controller.factorise(np.full_like(q, np.nan), (LEFT, DOUBLE), damping=0.0) is None


# ---- products and residuals without forming a row


def test_products_with_transposed_rows_are_those_of_the_explicit_matrices(model, states, rng):
    for q, _ in states:
        jacobians = model.jacobians(q)
        multipliers = RowMultipliers(
            dynamics=rng.standard_normal(6),
            com=10.0 * rng.standard_normal(3),
            soles={foot: rng.standard_normal(6) for foot in Foot},
            joints=rng.standard_normal(model.nv),
        )
        expected = (
            jacobians.M_unactuated.T @ multipliers.dynamics
            + jacobians.J_com.T @ multipliers.com
            + sum(jacobians.J_sole[foot].T @ multipliers.soles[foot] for foot in Foot)
            + multipliers.joints
        )
        product = model.transposed(q, multipliers)
        np.testing.assert_allclose(product, expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("rows", ["dynamics", "com", "left", "right", "joints"])
def test_each_kind_of_row_enters_such_a_product_by_itself(model, states, rng, rows):
    q = states[6].q
    # What was asked of the model before is forgotten.
    soles = dict.fromkeys(Foot, np.ones(6))
    model.transposed(q, RowMultipliers(np.ones(6), np.ones(3), soles, np.zeros(model.nv)))
    jacobians, multipliers = model.jacobians(q), RowMultipliers.zero(model.nv)
    matrix = {
        "dynamics": jacobians.M_unactuated,
        "com": jacobians.J_com,
        "left": jacobians.J_sole[Foot.LEFT],
        "right": jacobians.J_sole[Foot.RIGHT],
        "joints": np.eye(model.nv),
    }[rows]
    numbers = rng.standard_normal(len(matrix))
    if rows in ("left", "right"):
        multipliers.soles[Foot(rows)] = numbers
    else:
        setattr(multipliers, rows, numbers)
    expected = matrix.T @ numbers
    product = model.transposed(q, multipliers)
    np.testing.assert_allclose(product, expected, atol=1e-12 * np.abs(expected).max())


def test_rows_of_the_tasks_enter_such_a_product_with_their_weights(bench, states, rng):
    for state in states[:20]:
        residual = rng.standard_normal(bench.stack.layout.n_rows)
        multipliers = RowMultipliers.zero(bench.model.nv)
        bench.stack.add_task_multipliers(residual, multipliers, bench.model.kinematics(*state))
        expected = bench.matrices(state.q).A.T @ residual[bench.stack.task_rows]
        product = bench.model.transposed(state.q, multipliers)
        np.testing.assert_allclose(product, expected, atol=1e-11 * np.abs(expected).max())


def test_a_sole_moves_with_the_base_as_its_jacobian_says(model, states, rng):
    for q, v in states:
        now, jacobians = model.kinematics(q, v), model.jacobians(q)
        for foot in Foot:
            motion = rng.standard_normal(6)
            expected = jacobians.J_sole[foot][:, :6] @ motion
            moving = model.sole_motion_of_base(foot, now, motion)
            np.testing.assert_allclose(moving, expected, atol=1e-13 * np.abs(expected).max())


def test_the_residual_of_every_row_is_that_of_the_explicit_matrices(bench, states, rng):
    stack, nv = bench.stack, bench.model.nv
    for state in states:
        a, f = rng.standard_normal(nv), 50.0 * rng.standard_normal(stack.layout.n_forces)
        b = stack.right_hand_side(bench.model.kinematics(*state), bench.reference)
        problem, A = bench.problem(state), bench.matrices(state.q).A
        y = np.concatenate([a, f])
        _, residual = bench.linearised(state, y)
        for rows, expected in (
            (stack.equality_rows, b[stack.equality_rows] - problem.E @ y),
            (stack.task_rows, b[stack.task_rows] - A @ a),
        ):
            scale = max(1.0, np.abs(expected).max())
            np.testing.assert_allclose(residual[rows], expected, atol=1e-11 * scale)
        assert residual[-1] == 1.0


def test_the_residual_at_zero_is_b(bench, states):
    for state in states[:20]:
        b = bench.stack.right_hand_side(bench.model.kinematics(*state), bench.reference)
        _, residual = bench.linearised(state, Iterate.zero(bench.stack).y)
        scale = np.abs(b).max()
        np.testing.assert_allclose(residual, b, atol=1e-12 * scale)


def test_only_the_rows_said_to_vary_change_with_the_configuration(bench, states):
    stack = bench.stack
    expected = {DOUBLE: 3, LEFT: 9, RIGHT: 9}[stack.mode]
    assert len(stack.varying_task_rows) == expected
    fixed = np.setdiff1d(np.arange(len(stack.constant_task_rows)), stack.varying_task_rows)
    for state in states[:10]:
        A = bench.matrices(state.q).A
        np.testing.assert_array_equal(A[fixed], stack.constant_task_rows[fixed])
    np.testing.assert_array_equal(stack.constant_task_rows[stack.varying_task_rows], 0.0)
