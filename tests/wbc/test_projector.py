"""The contract of A†, Eq. (4), on fifty states per contact mode.

The reference is the QP of Eq. (2) with all its unknowns, solved by the dual active-set method. It
and the projector reach the optimum by different eliminations; they are compared relative to the
largest entry of y (about 100 N near standing, 1e5 in the wildest pose), since a and f share one
linear system whose rounding is that of its largest numbers.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from shared.wbc.answer import Projector
from shared.wbc.contacts import ROWS_PER_POINT, ContactMode
from shared.wbc.projector import condense, full_problem, hold, is_optimal, solve
from shared.wbc.qp import DaqpSolver, ProxsuiteSolver, QpStatus
from shared.wbc.stack import Stack, StackMatrices
from tests.wbc.kkt import are_independent, kkt, solution_of_active_set

# The requirement. Measured over 240 states per mode: 2e-11 against the full QP and on the equality
# rows, 3e-12 on active rows; 1e-13 near standing.
TOLERANCE = 1e-9

MODES = list(ContactMode)


@dataclasses.dataclass
class Case:
    """One state with its rows."""

    stack: Stack
    matrices: StackMatrices
    b: np.ndarray

    def solve(self, solver=None, **how):
        return solve(self.stack, self.matrices, self.b, solver=solver or DaqpSolver(), **how)

    @property
    def least_norm(self):
        return self.stack.least_norm(self.matrices)

    def hold(self, *active):
        return hold(self.stack, self.least_norm, np.array(active, dtype=int))

    def full_problem(self, b=None):
        return full_problem(self.stack, self.matrices, self.b if b is None else b)


def make_cases(stack, model, reference, states):
    return [
        Case(
            stack,
            stack.matrices(model.jacobians(q)),
            stack.right_hand_side(model.kinematics(q, v), reference),
        )
        for q, v in states
    ]


@pytest.fixture(scope="module", params=MODES, ids=lambda mode: mode.name)
def cases(request, stacks, model, reference, states):
    return make_cases(stacks[request.param], model, reference, states)


def relative(difference, y):
    return np.abs(difference).max(initial=0.0) / np.abs(y).max()


def test_the_states_exercise_empty_and_crowded_active_sets(cases):
    sizes = [len(case.solve().projector.active) for case in cases]
    assert min(sizes) <= 2
    assert max(sizes) >= 10


def test_fresh_projector_reproduces_the_qp_solution(cases):
    for case in cases:
        y = case.solve().projector.apply(case.b)
        expected = DaqpSolver().solve(case.full_problem())
        assert expected.status is QpStatus.SOLVED
        assert relative(y - expected.x, expected.x) < TOLERANCE


def test_fresh_projector_names_the_active_set_of_the_full_qp(cases):
    for case in cases:
        expected = DaqpSolver().solve(case.full_problem()).active
        np.testing.assert_array_equal(case.solve().projector.active, expected)


def test_fresh_projector_gives_an_optimal_point_of_the_full_qp(cases):
    for case in cases:
        projector = case.solve().projector
        y = projector.apply(case.b)
        judged = kkt(case.full_problem(), y, projector.active)
        scale = max(1.0, np.abs(y).max())
        # Gradient and multipliers are relative already; rows have entries of order one.
        assert judged.stationarity < TOLERANCE
        assert judged.negative_multiplier < TOLERANCE
        assert max(judged.equality, judged.violation, judged.slack) < TOLERANCE * scale


def test_both_back_ends_lead_to_the_same_active_set_and_solution(cases):
    for case in cases:
        projector = case.solve(DaqpSolver()).projector
        other = case.solve(ProxsuiteSolver()).projector
        np.testing.assert_array_equal(other.active, projector.active)
        np.testing.assert_array_equal(other.A_dagger, projector.A_dagger)


def test_the_tasks_that_determine_the_accelerations_are_inverted(cases):
    for case in cases:
        n_a = case.stack.layout.n_accelerations
        product = case.least_norm.T @ case.matrices.A[:n_a]
        np.testing.assert_allclose(product, np.eye(n_a), atol=1e-13)


def test_any_rows_that_are_held_give_the_solution_of_the_whole_kkt_system(cases, rng):
    for case in cases:
        points = len(case.stack.contacts.l) // ROWS_PER_POINT
        # One row at some of the points: what is independent, whether or not it is optimal.
        held = np.flatnonzero(rng.random(points) < 0.5)
        active = ROWS_PER_POINT * held + rng.integers(ROWS_PER_POINT, size=len(held))
        b = random_right_hand_side(case, rng)
        expected = solution_of_active_set(case.full_problem(b), active)
        y = case.hold(*active).projector.apply(b)
        assert relative(y - expected, expected) < TOLERANCE


class NoSolver:
    """A back end that must not be asked."""

    name = "none"

    def solve(self, problem, *, warm_active=None):
        raise AssertionError("asked")


def test_an_active_set_that_proves_to_be_optimal_saves_the_solver(cases):
    for case in cases:
        solved = case.solve()
        likely = case.solve(NoSolver(), likely_active=solved.projector.active)
        assert (likely.status, likely.iterations) == (QpStatus.SOLVED, 0)
        # The same formula in the same order: not a bit tells where the set came from.
        np.testing.assert_array_equal(likely.projector.A_dagger, solved.projector.A_dagger)


def test_a_set_with_a_row_more_or_less_or_of_another_state_is_not_believed(cases):
    for case, other in itertools.pairwise(cases):
        projector = case.solve().projector
        active = projector.active
        points = np.arange(len(case.stack.contacts.l) // ROWS_PER_POINT)
        untouched = np.setdiff1d(points, active // ROWS_PER_POINT)
        more = np.sort(np.append(active, ROWS_PER_POINT * untouched[:1]))
        for wrong in (active[1:], more, other.solve().projector.active):
            if np.array_equal(wrong, active):
                continue
            assert not is_optimal(case.stack, case.hold(*wrong), case.b)
            found = case.solve(likely_active=wrong)
            assert found.iterations > 0
            np.testing.assert_array_equal(found.projector.A_dagger, projector.A_dagger)


@pytest.mark.parametrize(("margin", "believed"), [(1e-3, True), (1e-6, False), (-1e-3, False)])
def test_a_set_that_is_optimal_by_a_hair_only_is_left_to_the_solver(
    robot, model, reference, configured, margin, believed
):
    def standing(**settings):
        stack = Stack(robot, configured(**settings).wbc, ContactMode.DOUBLE_SUPPORT)
        (case,) = make_cases(stack, model, reference, [(robot.q_standing, np.zeros(model.nv))])
        return case

    case = standing()
    least = case.hold().projector.apply(case.b)[model.nv + 2 :: 3].min()
    case = standing(**{"wbc.min_normal_force": float(least - margin)})
    assert is_optimal(case.stack, case.hold(), case.b) is believed


def test_one_solver_for_all_modes_and_states_gives_what_a_new_one_gives(
    stacks, model, reference, states
):
    # As the edge uses it: one back end for every message.
    for cls in (DaqpSolver, ProxsuiteSolver):
        solver = cls()
        for state in states[:20]:
            for stack in stacks.values():
                (case,) = make_cases(stack, model, reference, [state])
                y = case.solve(solver).projector.apply(case.b)
                assert relative(y - case.solve(cls()).projector.apply(case.b), y) < TOLERANCE


def test_equality_rows_hold_for_any_right_hand_side(cases, rng):
    for case in cases:
        b = random_right_hand_side(case, rng)
        y = case.solve().projector.apply(b)
        problem = case.full_problem(b)
        assert relative(problem.E @ y - problem.e, y) < TOLERANCE


def test_active_rows_stay_on_their_bound_for_any_right_hand_side(cases, rng):
    for case in cases:
        projector = case.solve().projector
        y = projector.apply(random_right_hand_side(case, rng))
        f = y[case.stack.layout.n_accelerations :]
        margins = (case.stack.contacts.C @ f - case.stack.contacts.l)[projector.active]
        assert relative(margins, y) < TOLERANCE


def test_a_stale_projector_is_optimal_for_its_own_active_set(cases, rng):
    # Fresh b, old A†: still the minimiser over the rows it was made for, whatever b is.
    for case in cases:
        projector = case.solve().projector
        b = random_right_hand_side(case, rng)
        judged = kkt(case.full_problem(b), projector.apply(b), projector.active)
        assert judged.stationarity < TOLERANCE


def test_active_rows_are_independent_together_with_the_equalities(cases):
    for case in cases:
        assert are_independent(case.full_problem(), case.solve().projector.active)


def test_projector_has_a_row_per_unknown_and_a_column_per_row_of_b(cases):
    projector = cases[0].solve().projector
    layout = cases[0].stack.layout
    assert projector.A_dagger.shape == (layout.n_unknowns, layout.n_rows)
    assert projector.mode is cases[0].stack.mode
    # What is sent as raw row-major bytes.
    assert projector.A_dagger.flags.c_contiguous


def test_condensed_problem_has_the_forces_of_the_full_one(cases):
    for case in cases:
        condensed = condense(case.stack, case.least_norm, case.b)
        expected = DaqpSolver().solve(case.full_problem()).x
        f = DaqpSolver().solve(condensed).x
        assert relative(f - expected[case.stack.layout.n_accelerations :], expected) < TOLERANCE


@pytest.mark.parametrize("cls", [DaqpSolver, ProxsuiteSolver])
def test_corners_where_points_carry_no_force_are_solved(
    robot, model, reference, states, configured, cls
):
    # With no least normal force an unloaded point sits at the apex: five rows, three unknowns.
    config = configured(**{"wbc.min_normal_force": 0.0})
    corners = 0
    for mode in ContactMode:
        for case in make_cases(Stack(robot, config.wbc, mode), model, reference, states[:24]):
            solution = case.solve(cls())
            assert solution.status is QpStatus.SOLVED
            assert are_independent(case.full_problem(), solution.projector.active)
            y = solution.projector.apply(case.b)
            expected = DaqpSolver().solve(case.full_problem()).x
            assert relative(y - expected, expected) < TOLERANCE
            f = y[case.stack.layout.n_accelerations :].reshape(-1, 3)
            corners += int(np.sum(np.abs(f).max(axis=1) < 1e-9 * np.abs(y).max()))
    assert corners > 20


def test_a_robot_that_stands_at_rest_is_asked_to_carry_its_weight_and_stay(
    robot, model, reference, stacks
):
    stack = stacks[ContactMode.DOUBLE_SUPPORT]
    (case,) = make_cases(stack, model, reference, [(robot.q_standing, np.zeros(model.nv))])
    y = case.solve().projector.apply(case.b)
    a, f = y[: model.nv], y[model.nv :].reshape(-1, 3)
    # The force weight of 1e-5 pulls the optimum off a = 0 a little: measured 0.05 rad/s².
    assert np.abs(a).max() < 0.1
    assert f[:, 2].sum() == pytest.approx(robot.mass * 9.81, rel=1e-3)
    np.testing.assert_allclose(f[:, :2].sum(axis=0), 0.0, atol=1e-2 * robot.mass * 9.81)


def test_holding_no_row_leaves_the_bounds_without_effect(cases):
    np.testing.assert_array_equal(cases[0].hold().projector.A_dagger[:, -1], 0.0)


@pytest.mark.parametrize("cls", [DaqpSolver, ProxsuiteSolver])
@pytest.mark.parametrize("where", ["b", "E_a", "E_f", "A"])
@pytest.mark.parametrize("entry", [0, 7, -1])
def test_input_that_is_no_number_gives_a_status_and_no_projector(cases, cls, where, entry):
    case = cases[0]
    b, matrices = case.b.copy(), case.matrices
    # The last entry of b is the constant 1.
    array = b[:-1] if where == "b" else getattr(matrices, where).copy()
    if where == "A":
        # The other entries are constants, of which no copy is read.
        array[case.stack.varying_task_rows[entry % 3], 3:].flat[entry] = np.nan
    else:
        array.flat[entry] = np.nan
    if where != "b":
        matrices = dataclasses.replace(matrices, **{where: array})
    solution = solve(case.stack, matrices, b, solver=cls())
    assert solution.status is QpStatus.NOT_FINITE
    assert solution.projector is None


def test_dependent_rows_give_a_status_and_no_projector(cases):
    case = cases[0]
    contact_without_row = case.matrices.E_a.copy()
    contact_without_row[7] = 0.0
    matrices = dataclasses.replace(case.matrices, E_a=contact_without_row)
    for likely in (None, np.empty(0, dtype=int)):
        solution = solve(case.stack, matrices, case.b, solver=DaqpSolver(), likely_active=likely)
        assert solution.status is QpStatus.NOT_FINITE
        assert solution.projector is None


@pytest.mark.parametrize("cls", [DaqpSolver, ProxsuiteSolver])
def test_friction_rows_that_exclude_each_other_are_infeasible(robot, config, cases, cls):
    stack = Stack(robot, config.wbc, cases[0].stack.mode)
    contacts = stack.contacts
    # The first point must push at least 1 N and may not push at all.
    C = np.vstack([contacts.C, -contacts.C[4]])
    stack.contacts = dataclasses.replace(contacts, C=C, l=np.append(contacts.l, 0.0))
    case = cases[0]
    solution = solve(stack, case.matrices, case.b, solver=cls())
    # Proximal iterations do not always prove it and then stop at their limit.
    allowed = {QpStatus.INFEASIBLE} | (
        {QpStatus.ITERATION_LIMIT} if cls is ProxsuiteSolver else set()
    )
    assert solution.status in allowed
    assert solution.projector is None


def test_applying_a_projector_is_the_matrix_times_b(rng):
    A_dagger, b = rng.standard_normal((4, 3)), rng.standard_normal(3)
    projector = Projector(ContactMode.DOUBLE_SUPPORT, A_dagger, np.empty(0, dtype=int))
    np.testing.assert_array_equal(projector.apply(b), A_dagger @ b)


def random_right_hand_side(case, rng):
    """Any feedback of the size of a real one; the constant last entry stays 1."""
    b = np.abs(case.b).max() * rng.standard_normal(len(case.b))
    b[-1] = 1.0
    return b
