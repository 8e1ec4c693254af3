from __future__ import annotations

import dataclasses
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import ConfigError
from shared.process.entry import python
from shared.wbc.qp import (
    DaqpSolver,
    ProxsuiteSolver,
    QpStatus,
    QuadraticProgram,
    independent_rows,
    make_solver,
)
from tests.wbc.kkt import are_independent, kkt, solution_of_active_set

SOLVERS: dict[str, type[DaqpSolver | ProxsuiteSolver]] = {
    "daqp": DaqpSolver,
    "proxsuite": ProxsuiteSolver,
}
# Worst of 3000 such problems. The dual active-set method ends at a vertex of its working set:
# 6e-13, rounding. The augmented Lagrangian stops at its accuracy of 1e-9, and without a check of
# the duality gap leaves an active row a little off its bound: 3e-5. Its x is not used, its active
# set is: recomputed from that, both are optimal to 2e-13.
POINT_TOLERANCE = {"daqp": 1e-11, "proxsuite": 1e-4}
ACTIVE_SET_TOLERANCE = 1e-11


@pytest.fixture(params=list(SOLVERS))
def solver(request):
    return SOLVERS[request.param]()


def random_problem(rng: np.random.Generator) -> QuadraticProgram:
    """A strictly convex feasible problem with up to 24 unknowns, 12 equalities, 71 inequalities."""
    n = int(rng.integers(1, 25))
    m_e, m = int(rng.integers(0, n // 2 + 1)), int(rng.integers(0, 3 * n))
    root = rng.standard_normal((n, n))
    inside = rng.standard_normal(n)
    C = rng.standard_normal((m, n))
    E = rng.standard_normal((m_e, n)) if m_e else None
    return QuadraticProgram(
        H=root @ root.T + 0.1 * np.eye(n),
        g=3.0 * rng.standard_normal(n),
        C=C,
        l=C @ inside - rng.random(m),
        E=E,
        e=None if E is None else E @ inside,
    )


def apex_problem(*, g: tuple[float, float, float]) -> QuadraticProgram:
    """One point force that may only push, inside a friction pyramid that ends in f = 0."""
    mu = 0.5
    C = np.array([[1, 0, mu], [-1, 0, mu], [0, 1, mu], [0, -1, mu], [0, 0, 1.0]])
    return QuadraticProgram(H=np.eye(3), g=np.array(g), C=C, l=np.zeros(5))


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_solutions_of_random_problems_are_optimal(seed):
    problem = random_problem(np.random.default_rng(seed))
    for name, cls in SOLVERS.items():
        solution = cls().solve(problem)
        assert solution.status is QpStatus.SOLVED
        assert are_independent(problem, solution.active)
        # Judged at the point that the active set fixes, since that is what is used of it.
        judged = kkt(problem, solution_of_active_set(problem, solution.active), solution.active)
        assert max(judged) < ACTIVE_SET_TOLERANCE, (name, judged)
        assert max(kkt(problem, solution.x, solution.active)) < POINT_TOLERANCE[name]


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_both_back_ends_find_the_same_optimum(seed):
    problem = random_problem(np.random.default_rng(seed))
    x = [solution_of_active_set(problem, cls().solve(problem).active) for cls in SOLVERS.values()]
    np.testing.assert_allclose(
        x[0], x[1], rtol=0.0, atol=ACTIVE_SET_TOLERANCE * max(1.0, np.abs(x[0]).max())
    )


def test_active_rows_come_sorted_and_once(solver, rng):
    for _ in range(20):
        active = solver.solve(random_problem(rng)).active
        assert np.all(np.diff(active) > 0)


def test_a_solver_that_is_used_again_forgets_the_last_problem(solver, rng):
    problems = [random_problem(rng) for _ in range(15)]
    # Same sizes, other numbers: what a workspace kept between calls could mix up.
    problems += [dataclasses.replace(problem, g=-problem.g) for problem in problems]
    for problem in problems:
        again, fresh = solver.solve(problem), type(solver)().solve(problem)
        assert again.status is fresh.status is QpStatus.SOLVED
        np.testing.assert_array_equal(again.active, fresh.active)


def test_daqp_solves_again_to_the_last_bit_what_it_has_solved(rng):
    solver = DaqpSolver()
    problems = [random_problem(rng) for _ in range(15)]
    problems += [dataclasses.replace(problem, g=-problem.g) for problem in problems]
    for problem in problems:
        x = DaqpSolver().solve(problem).x
        np.testing.assert_array_equal(solver.solve(problem).x, x)


def test_a_solver_leaves_the_problem_as_it_was(solver, rng):
    problem = random_problem(rng)
    before = {f.name: np.copy(getattr(problem, f.name)) for f in dataclasses.fields(problem)}
    solver.solve(problem)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(problem, name), value)


def test_a_warm_start_changes_the_way_and_not_the_answer(solver, rng):
    for _ in range(20):
        problem = random_problem(rng)
        cold = solver.solve(problem)
        warm = solver.solve(problem, warm_active=cold.active)
        assert warm.status is QpStatus.SOLVED
        np.testing.assert_array_equal(warm.active, cold.active)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_first_call_may_be_warm(name):
    # In a process of its own: what went wrong here ended the process.
    program = (
        "import numpy as np\n"
        "from shared.wbc.qp import QuadraticProgram, make_solver\n"
        "problem = QuadraticProgram(np.eye(2), np.ones(2), np.eye(2), np.zeros(2))\n"
        f"solver = make_solver({name!r})\n"
        "for _ in range(2):\n"
        "    print(solver.solve(problem, warm_active=np.array([0])).active.tolist())\n"
    )
    done = subprocess.run(python("-c", program), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[0, 1]\n[0, 1]\n"), done.stderr


def test_a_warm_call_after_an_infeasible_problem_starts_anew(solver):
    good = QuadraticProgram(
        H=np.eye(2), g=np.zeros(2), C=np.array([[1.0, 0.0], [-1.0, 0.0]]), l=np.array([1.0, -2.0])
    )
    solver.solve(dataclasses.replace(good, l=np.array([1.0, 0.0])))
    solution = solver.solve(good, warm_active=np.array([0]))
    assert solution.status is QpStatus.SOLVED
    assert solution.active.tolist() == [0]


def test_a_problem_without_constraints_is_a_linear_system(solver):
    H, g = np.diag([1.0, 4.0]), np.array([-1.0, 8.0])
    solution = solver.solve(QuadraticProgram(H=H, g=g, C=np.zeros((0, 2)), l=np.zeros(0)))
    assert solution.status is QpStatus.SOLVED
    np.testing.assert_allclose(solution.x, [1.0, -2.0], atol=1e-8)
    assert solution.active.size == 0


@pytest.mark.parametrize(
    ("optimum", "expected"),
    [((0.0, 0.0, -10.0), 0.0), ((1.0, -2.0, -10.0), 0.0), ((8.0, 0.0, -1.0), None)],
)
def test_the_active_set_is_independent_at_the_apex_of_a_pyramid(solver, optimum, expected):
    # Five rows are tight for three unknowns; factorising all of them would divide by zero.
    problem = apex_problem(g=tuple(-np.array(optimum)))
    solution = solver.solve(problem)
    assert solution.status is QpStatus.SOLVED
    assert len(solution.active) <= 3
    assert are_independent(problem, solution.active)
    x = solution_of_active_set(problem, solution.active)
    judged = kkt(problem, x, solution.active)
    # Which of the tight rows represent the corner is free, so their multipliers may have any sign.
    assert max(judged._replace(negative_multiplier=0.0)) < 1e-12
    if expected is not None:
        np.testing.assert_allclose(x, expected, atol=1e-12)


def test_independent_rows_keep_the_span_of_their_candidates():
    problem = apex_problem(g=(0.0, 0.0, 1.0))
    kept = independent_rows(problem, np.arange(5))
    assert len(kept) == 3
    assert np.linalg.matrix_rank(problem.C[kept]) == 3


def test_independent_rows_leave_out_what_the_equalities_already_say():
    # E fixes f_x: of ±f_x + μ f_z only one says more.
    problem = dataclasses.replace(
        apex_problem(g=(0.0, 0.0, 1.0)), E=np.array([[1.0, 0.0, 0.0]]), e=np.zeros(1)
    )
    kept = independent_rows(problem, np.array([0, 1]))
    assert len(kept) == 1
    assert are_independent(problem, kept)


def test_independent_rows_of_nothing_are_nothing():
    empty = np.empty(0, dtype=int)
    assert independent_rows(apex_problem(g=(0.0, 0.0, 0.0)), empty).size == 0


# Proximal iterations do not always prove infeasibility; they are then stopped by their limit.
UNSOLVED = {
    "daqp": {QpStatus.INFEASIBLE},
    "proxsuite": {QpStatus.INFEASIBLE, QpStatus.ITERATION_LIMIT},
}


def test_an_infeasible_problem_is_not_called_solved(solver, rng):
    for _ in range(10):
        problem = random_problem(rng)
        n = problem.H.shape[0]
        row = np.ones((1, n))
        C = np.vstack([problem.C, row, -row])
        apart = dataclasses.replace(problem, C=C, l=np.append(problem.l, [1.0, 0.0]))
        solution = solver.solve(apart)
        assert solution.status in UNSOLVED[solver.name]
        assert solution.x.size == solution.active.size == 0


def test_a_solver_works_again_after_an_infeasible_problem(solver):
    good = QuadraticProgram(
        H=np.eye(2), g=np.zeros(2), C=np.array([[1.0, 0.0], [-1.0, 0.0]]), l=np.array([1.0, -2.0])
    )
    assert (
        solver.solve(dataclasses.replace(good, l=np.array([1.0, 0.0]))).status
        in (UNSOLVED[solver.name])
    )
    solution = solver.solve(good)
    assert solution.status is QpStatus.SOLVED
    assert solution.active.tolist() == [0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["H", "g", "C", "l", "E", "e"])
def test_a_number_that_is_not_finite_is_named_before_it_reaches_the_solver(solver, name, value):
    problem = QuadraticProgram(
        H=np.eye(3),
        g=np.ones(3),
        C=np.eye(3),
        l=np.zeros(3),
        E=np.ones((1, 3)),
        e=np.ones(1),
    )
    damaged = getattr(problem, name).copy()
    damaged.flat[0] = value
    assert solver.solve(dataclasses.replace(problem, **{name: damaged})).status is (
        QpStatus.NOT_FINITE
    )


def test_solvers_are_made_by_their_names():
    assert {name: make_solver(name).name for name in SOLVERS} == {name: name for name in SOLVERS}


def test_an_unknown_solver_is_refused_with_the_names_that_exist():
    with pytest.raises(ConfigError) as error:
        make_solver("simplex")
    for name in ("'simplex'", *SOLVERS):
        assert name in str(error.value)
