"""What a stale factorisation corrected by exact residuals comes to: the contract of each level.

The reference is the QP of Eq. (2) with all its unknowns, solved by the dual active-set method, and
the explicit matrices. y is compared relative to its largest entry, as in `test_projector.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from shared.wbc.answer import Factorisation
from shared.wbc.contacts import FORCES_PER_FOOT
from shared.wbc.correction import Corrector, Iterate
from tests.states import State
from tests.wbc.correction_bench import (
    DOUBLE,
    EXACT_CONSTRAINTS,
    LEFT,
    LEVELS,
    RIGHT,
    TOLERANCE,
    TURNS,
    Bench,
    moved,
    outside_span,
    relative,
)

# ---- one step


@pytest.mark.parametrize("level", LEVELS)
def test_one_step_from_zero_with_a_fresh_factorisation_is_the_optimum(bench, states, level):
    sizes = []
    for state in states:
        expected = bench.optimum(state)
        corrector = Corrector(bench.stack, bench.factorise(state.q), level=level)
        iterate, active_set = bench.step(corrector, Iterate.zero(bench.stack), state)
        assert relative(iterate.y - expected.x, expected.x) < TOLERANCE
        assert active_set == bench.stack.mode.active_set(expected.active)
        sizes.append(len(expected.active))
    # The states exercise empty and crowded active sets.
    assert min(sizes) <= 2
    assert max(sizes) >= 10


@pytest.mark.parametrize("level", LEVELS)
def test_forces_that_obey_the_friction_rows_are_left_as_they_are(double, robot, level):
    # Standing still, no row is tight: the QP without friction rows has the same optimum.
    state = State(robot.q_standing, np.zeros(double.model.nv))
    problem = double.problem(state)
    n, n_e = len(problem.g), len(problem.e)
    kkt = np.block([[problem.H, problem.E.T], [problem.E, np.zeros((n_e, n_e))]])
    expected = np.linalg.solve(kkt, np.concatenate([-problem.g, problem.e]))[:n]
    assert (problem.C @ expected > problem.l).all()
    corrector = Corrector(double.stack, double.factorise(state.q), level=level)
    iterate, active_set = double.step(corrector, Iterate.zero(double.stack), state)
    assert active_set == 0
    assert relative(iterate.y - expected, expected) < TOLERANCE


@pytest.mark.parametrize("level", ["b_adjoint", "c"])
def test_the_multipliers_are_those_of_the_equalities(bench, states, level):
    for state in states:
        problem, expected = bench.problem(state), bench.optimum(state)
        corrector = Corrector(bench.stack, bench.factorise(state.q), level=level)
        iterate, _ = bench.step(corrector, Iterate.zero(bench.stack), state)
        gradient = problem.H @ iterate.y + problem.g
        remainder = gradient - problem.E.T @ iterate.nu
        # What is left is carried by the active friction rows.
        rows = problem.C[expected.active]
        if len(rows):
            multipliers = np.linalg.lstsq(rows.T, remainder, rcond=None)[0]
            remainder = remainder - rows.T @ multipliers
        assert np.abs(remainder).max() < TOLERANCE * max(1.0, np.abs(gradient).max())


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_a_factorisation_is_as_good_wherever_the_robot_has_gone(bench, states, rng, turn, level):
    for state in states[:12]:
        corrector = Corrector(bench.stack, bench.factorise(state.q), level=level)
        there = State(moved(state.q, turn, rng.uniform(-2.0, 2.0, 3)), state.v)
        expected = bench.optimum(there).x
        iterate, _ = bench.step(corrector, Iterate.zero(bench.stack), there)
        assert relative(iterate.y - expected, expected) < TOLERANCE


@pytest.mark.parametrize("level", EXACT_CONSTRAINTS)
def test_one_step_from_zero_is_the_stale_optimum_with_a_fresh_active_set(bench, pairs, level):
    for state, elsewhere in pairs:
        expected = bench.optimum(state, matrices_at=elsewhere)
        corrector = Corrector(bench.stack, bench.factorise(elsewhere), level=level)
        iterate, active_set = bench.step(corrector, Iterate.zero(bench.stack), state)
        assert relative(iterate.y - expected.x, expected.x) < TOLERANCE
        assert active_set == bench.stack.mode.active_set(expected.active)


@pytest.mark.parametrize("level", LEVELS)
def test_a_step_leaves_the_iterate_it_starts_from_as_it_is(bench, pairs, level):
    state, elsewhere = pairs[0]
    corrector = Corrector(bench.stack, bench.factorise(elsewhere), level=level)
    first, _ = bench.step(corrector, Iterate.zero(bench.stack), state)
    y, nu = first.y.copy(), first.nu.copy()
    bench.step(corrector, first, state)
    np.testing.assert_array_equal(first.y, y)
    np.testing.assert_array_equal(first.nu, nu)


# ---- many steps from a stale factorisation


@pytest.mark.parametrize("level", EXACT_CONSTRAINTS)
def test_the_equality_rows_come_to_hold(bench, pairs, level):
    rows = bench.stack.equality_rows
    for state, elsewhere in pairs:
        start = np.linalg.norm(bench.linearised(state, Iterate.zero(bench.stack).y)[1][rows])
        blocks = bench.factorise(elsewhere)
        last = bench.converged(blocks, state, level=level, steps=15)
        # 2e-9 measured after 15 steps, each of which leaves a quarter at most.
        assert np.linalg.norm(bench.linearised(state, last.y)[1][rows]) < 1e-6 * start


@pytest.mark.parametrize("level", LEVELS)
def test_the_friction_rows_hold_after_every_step(bench, pairs, level):
    tight = 0
    for state, elsewhere in pairs:
        blocks = bench.factorise(elsewhere)
        for iterate in bench.iterates(blocks, state, level=level, steps=15):
            margins = bench.stack.contacts.C @ iterate.y[bench.model.nv :] - bench.stack.contacts.l
            # Newtons: 2e-11 measured.
            assert margins.min() > -1e-8
            tight += int(np.sum(np.abs(margins) < 1e-8))
    # They are not idle.
    assert tight > 100


@pytest.mark.parametrize("level", EXACT_CONSTRAINTS)
def test_what_corrections_come_to_is_optimal_in_what_the_level_takes_exact(bench, pairs, level):
    # The tasks are traded off by the stale Aᵀ. Level B sees the stale constraints' gradient too.
    for state, elsewhere in pairs:
        blocks = bench.factorise(elsewhere)
        last = bench.converged(blocks, state, level=level, steps=40)
        _, residual = bench.linearised(state, last.y)
        f = last.y[bench.model.nv :]
        gradient = -bench.stack.force_weight * np.concatenate([np.zeros(bench.model.nv), f])
        gradient[: bench.model.nv] += blocks.A.T @ residual[bench.stack.task_rows]
        stale, fresh = bench.problem(state, matrices_at=elsewhere).E, bench.problem(state).E
        C = bench.problem(state).C
        active = np.abs(C @ last.y - bench.stack.contacts.l) < 1e-8
        exact, other = (stale, fresh) if level == "b" else (fresh, stale)
        assert outside_span(gradient, np.vstack([exact, C[active]])) < 1e-7
        assert outside_span(gradient, np.vstack([other, C[active]])) > 1e-4


def test_the_exact_gradient_of_the_constraints_brings_corrections_nearer_to_the_optimum(
    bench, pairs
):
    errors = {}
    for level in EXACT_CONSTRAINTS:
        errors[level] = [
            relative(
                bench.converged(bench.factorise(elsewhere), state, level=level, steps=30).y
                - bench.optimum(state).x,
                bench.optimum(state).x,
            )
            for state, elsewhere in pairs
        ]
    # Both feet: 4.3 % against 0.4 %. One: 2.3 % against 1.6 %, for more is left to the stale Aᵀ.
    assert np.mean(errors["b_adjoint"]) < 0.8 * np.mean(errors["b"])
    assert np.mean(errors["b"]) < 0.1


def test_level_c_comes_to_the_optimum_on_both_feet(double, pairs):
    for state, elsewhere in pairs:
        expected = double.optimum(state)
        last = double.converged(double.factorise(elsewhere), state, level="c", steps=60)
        assert relative(last.y - expected.x, expected.x) < 1e-6


@pytest.mark.parametrize("mode", [LEFT, RIGHT], ids=lambda mode: mode.name)
def test_damped_level_c_comes_to_the_optimum_on_one_foot(stacks, model, reference, pairs, mode):
    bench = Bench(stacks[mode], model, reference)
    for state, elsewhere in pairs:
        expected = bench.optimum(state)
        blocks = bench.factorise(elsewhere, damping=0.05)
        last = bench.converged(blocks, state, level="c", steps=150)
        assert relative(last.y - expected.x, expected.x) < 1e-4


def test_what_corrections_come_to_does_not_depend_on_where_they_began(bench, pairs, rng):
    for state, elsewhere in pairs[:4]:
        blocks = bench.factorise(elsewhere)
        expected = bench.converged(blocks, state, level="b", steps=30)
        corrector = Corrector(bench.stack, blocks, level="b")
        iterate = Iterate.zero(bench.stack)
        iterate.y[:] = 100.0 * rng.standard_normal(len(iterate.y))
        for _ in range(30):
            iterate, _ = bench.step(corrector, iterate, state)
        assert relative(iterate.y - expected.y, expected.y) < 1e-7


# ---- the start in another contact mode


def test_in_another_mode_accelerations_and_the_forces_of_feet_that_stay_are_kept(stacks, model):
    nv, foot = model.nv, FORCES_PER_FOOT
    a = np.arange(nv) + 1.0
    left, right = np.full(foot, 2.0), np.full(foot, 3.0)
    forces = {DOUBLE: (left, right), LEFT: (left,), RIGHT: (right,)}
    expected = {
        (DOUBLE, LEFT): (left,),
        (DOUBLE, RIGHT): (right,),
        (LEFT, DOUBLE): (left, 0.0 * right),
        (RIGHT, DOUBLE): (0.0 * left, right),
        (LEFT, RIGHT): (0.0 * right,),
        (RIGHT, LEFT): (0.0 * left,),
        (DOUBLE, DOUBLE): (left, right),
    }
    for (before, after), kept in expected.items():
        stack = stacks[before]
        iterate = Iterate.zero(stack)
        iterate.y[:] = np.concatenate([a, *forces[before]])
        iterate.nu[:] = 4.0
        started = iterate.in_mode(stacks[after], nv)
        assert started.mode is after
        np.testing.assert_array_equal(started.y, np.concatenate([a, *kept]))
        # Multipliers belong to rows that are others now.
        np.testing.assert_array_equal(started.nu, np.zeros(stacks[after].equality_rows.stop))
        np.testing.assert_array_equal(iterate.y, np.concatenate([a, *forces[before]]))


def test_zero_has_the_shapes_of_its_mode(bench):
    zero, stack = Iterate.zero(bench.stack), bench.stack
    assert zero.mode is stack.mode
    assert zero.y.shape == (stack.layout.n_unknowns,)
    assert zero.nu.shape == (stack.equality_rows.stop,)
    assert not zero.y.any()
    assert not zero.nu.any()


# ---- what cannot be


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("scale", [np.nan, np.inf, 1e300, 1e150, 1e20, 1e10], ids=str)
def test_an_absurd_residual_gives_nothing_or_numbers_and_does_not_spoil_the_next_step(
    bench, pairs, level, scale
):
    state, elsewhere = pairs[1]
    blocks = bench.factorise(elsewhere)
    used = Corrector(bench.stack, blocks, level=level)
    new = Corrector(bench.stack, blocks, level=level)
    zero = Iterate.zero(bench.stack)
    now, residual = bench.linearised(state, zero.y)
    # That numbers overflow on the way is the point; NumPy need not say so.
    with np.errstate(all="ignore"):
        stepped = used.step(zero, scale * residual, bench.model, now)
    if stepped is None:
        assert not scale < 1e15
    else:
        assert np.isfinite(stepped[0].y).all()
        assert np.isfinite(scale)
    again, expected = (each.step(zero, residual, bench.model, now) for each in (used, new))
    assert again is not None
    assert expected is not None
    # Another order of the active rows, another rounding.
    assert relative(again[0].y - expected[0].y, expected[0].y) < 1e-12
    assert again[1] == expected[1]


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("row", [0, 7, 20, -2])
def test_one_number_that_is_none_in_the_residual_gives_nothing(bench, pairs, level, row):
    state, elsewhere = pairs[1]
    corrector = Corrector(bench.stack, bench.factorise(elsewhere), level=level)
    now, residual = bench.linearised(state, Iterate.zero(bench.stack).y)
    residual[row] = np.nan
    assert corrector.step(Iterate.zero(bench.stack), residual, bench.model, now) is None


def test_correctors_do_not_share_their_active_sets(bench, pairs):
    (state, elsewhere), (other_state, other_place) = pairs[:2]

    def alone(state, elsewhere):
        return [each.y for each in bench.iterates(bench.factorise(elsewhere), state, **how)]

    how = {"level": "b", "steps": 5}
    first, second = alone(state, elsewhere), alone(other_state, other_place)
    together = zip(
        bench.iterates(bench.factorise(elsewhere), state, **how),
        bench.iterates(bench.factorise(other_place), other_state, **how),
        strict=True,
    )
    for k, (one, other) in enumerate(together):
        np.testing.assert_array_equal(one.y, first[k])
        np.testing.assert_array_equal(other.y, second[k])


def test_forces_that_are_not_definite_are_refused_before_the_first_step(bench, states):
    blocks = bench.factorise(states[0].q)
    for P in (-blocks.P, np.zeros_like(blocks.P), np.diag([1.0] * (len(blocks.P) - 1) + [-1e-3])):
        broken = Factorisation(blocks.mode, P, blocks.Q, blocks.T, blocks.A, blocks.posture)
        with pytest.raises(np.linalg.LinAlgError):
            Corrector(bench.stack, broken, level="b")
