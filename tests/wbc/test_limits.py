"""The robot's own limits as rows of the QP: projectors and corrections with some of them active.

The reference is the QP with all its unknowns and one violation for each limited quantity.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.config.settings import LimitsConfig
from shared.wbc.correction import Corrector, Iterate
from shared.wbc.limits import Limits
from shared.wbc.projector import full_problem, hold, solve
from shared.wbc.qp import DaqpSolver, ProxsuiteSolver, QpStatus
from shared.wbc.stack import Stack
from shared.wbc.torque import recover_torque
from tests.states import State, random_state
from tests.wbc.correction_bench import LEVELS, MODES, TOLERANCE, Bench, relative
from tests.wbc.kkt import are_independent

ALL = LimitsConfig(torque=True, position=True, velocity=True)


def limited_stack(robot, config, mode, *, kinds=ALL, clamp=1.0):
    return Stack(robot, config.wbc, mode, Limits(robot, kinds, torque_clamp=clamp))


@pytest.fixture(scope="module", params=MODES, ids=lambda mode: mode.name)
def limited(request, robot, config, model, reference):
    return Bench(limited_stack(robot, config, request.param), model, reference)


@pytest.fixture(scope="module")
def wild_states(robot):
    """Twelve states near standing, of which the faster ones make many limits active."""
    rng = np.random.default_rng(7)
    states = [random_state(robot, spread=0.05, rng=rng) for _ in range(12)]
    return [State(q, 3.0 * (k % 3) * v) for k, (q, v) in enumerate(states)]


def rows(bench, state):
    b = bench.stack.right_hand_side(bench.model.kinematics(*state), bench.reference)
    return bench.matrices(state.q), b


def split(bench, x):
    n = bench.stack.layout.n_unknowns
    return x[:n], x[n:]


def test_the_entries_of_b_and_their_matrix_give_torques_and_joint_accelerations(
    limited, robot, states, rng
):
    stack, n_x = limited.stack, 62
    y = rng.standard_normal(stack.layout.n_unknowns)
    tau_scale = 0.98 * robot.effort_limit
    for state in states[:8]:
        matrices, b = rows(limited, state)
        _, residual = limited.linearised(state, y)
        n_rows = stack.layout.n_rows
        x = matrices.D @ y
        tau = recover_torque(limited.model, stack.contacts, state.q, state.v, y)
        lower, upper = np.split(residual[n_rows:], 2)
        np.testing.assert_allclose(lower, b[n_rows:][:n_x] - x, atol=1e-7)
        np.testing.assert_allclose(upper, b[n_rows:][n_x:] + x, atol=1e-7)
        np.testing.assert_allclose(lower[:31], -1.0 - tau / tau_scale, atol=1e-9)
        np.testing.assert_allclose(upper[:31], tau / tau_scale - 1.0, atol=1e-9)
        np.testing.assert_allclose(x[31:], y[6:37])


@pytest.mark.parametrize("solver", [DaqpSolver, ProxsuiteSolver])
def test_a_projector_with_active_limits_reproduces_the_full_qp(limited, wild_states, solver):
    active = []
    for state in wild_states:
        matrices, b = rows(limited, state)
        problem = full_problem(limited.stack, matrices, b)
        expected = DaqpSolver().solve(problem)
        assert expected.status is QpStatus.SOLVED
        solution = solve(limited.stack, matrices, b, solver=solver())
        assert solution.status is QpStatus.SOLVED
        projector = solution.projector
        y, _ = split(limited, expected.x)
        assert relative(projector.apply(b) - y, y) < TOLERANCE
        first = len(limited.stack.contacts.l)
        both = np.concatenate([projector.active, first + projector.limits])
        np.testing.assert_array_equal(both, expected.active)
        assert are_independent(problem, both)
        active.append(len(projector.limits))
    # The states exercise no limit and many.
    assert min(active) == 0
    assert max(active) >= 8


def test_the_active_set_of_the_last_state_saves_the_solver_and_changes_no_bit(limited, wild_states):
    class NoSolver:
        name = "none"

        def solve(self, problem, *, warm_active=None):
            raise AssertionError("asked")

    for state in wild_states:
        matrices, b = rows(limited, state)
        projector = solve(limited.stack, matrices, b, solver=DaqpSolver()).projector
        again = solve(
            limited.stack,
            matrices,
            b,
            solver=NoSolver(),
            likely_active=projector.active,
            likely_limits=projector.limits,
        )
        np.testing.assert_array_equal(again.projector.A_dagger, projector.A_dagger)


def test_a_wrong_set_of_limits_is_not_believed(limited, wild_states):
    for state in wild_states[:4]:
        matrices, b = rows(limited, state)
        right = solve(limited.stack, matrices, b, solver=DaqpSolver()).projector
        wrong = np.setxor1d(right.limits, [3, 70])
        found = solve(
            limited.stack,
            matrices,
            b,
            solver=DaqpSolver(),
            likely_active=right.active,
            likely_limits=wrong,
        )
        np.testing.assert_array_equal(found.projector.A_dagger, right.A_dagger)


def test_a_stale_projector_keeps_its_limits_with_a_fresh_b(limited, wild_states):
    """LA: with another velocity, the active limits hold with the bounds of that velocity."""
    stack, kept = limited.stack, 0
    n_rows = stack.layout.n_rows
    for state in wild_states:
        matrices, b = rows(limited, state)
        projector = solve(stack, matrices, b, solver=DaqpSolver()).projector
        k = len(projector.limits)
        if not k:
            continue
        later = State(state.q, 1.05 * state.v)
        _, b = rows(limited, later)
        _, residual = limited.linearised(later, projector.apply(b))
        held = hold(stack, stack.least_norm(matrices), projector.active, projector.limits)
        multipliers = held.multipliers[-k:] @ np.append(b[:n_rows], b[n_rows + projector.limits])
        # All that a row misses it pays for: s = λ/ω.
        slack = stack.slack[projector.limits % 62] * multipliers
        misses = residual[n_rows + projector.limits]
        np.testing.assert_allclose(misses, slack, atol=1e-6 * np.abs(b).max())
        kept += 1
    assert kept >= 6


def test_an_impossible_limit_softens_before_dynamics_contacts_and_friction(
    robot, config, model, reference, wild_states
):
    # A twentieth of the torque limits does not stop a robot in motion.
    bench = Bench(limited_stack(robot, config, MODES[0], clamp=0.05), model, reference)
    state = wild_states[2]
    matrices, b = rows(bench, state)
    solution = solve(bench.stack, matrices, b, solver=DaqpSolver())
    assert solution.status is QpStatus.SOLVED
    y = solution.projector.apply(b)
    _, residual = bench.linearised(state, y)
    scale = np.abs(y).max()
    assert np.abs(residual[bench.stack.equality_rows]).max() < 1e-6 * scale
    contacts = bench.stack.contacts
    assert (contacts.C @ y[37:] - contacts.l).min() > -1e-6 * scale
    assert residual[bench.stack.layout.n_rows :].max() > 0.1


def test_a_joint_far_beyond_its_range_does_not_ask_for_more_than_its_motor_has(
    robot, config, model, reference
):
    bench = Bench(limited_stack(robot, config, MODES[0], clamp=0.5), model, reference)
    q = robot.q_standing.copy()
    elbow = robot.model.getJointId("LElbowRoll") - 2
    q[7 + elbow] = robot.position_limit[1, elbow] + 2.0
    state = State(q, np.zeros(37))
    matrices, b = rows(bench, state)
    y = solve(bench.stack, matrices, b, solver=DaqpSolver()).projector.apply(b)
    _, residual = bench.linearised(state, y)
    misses, n_x = residual[bench.stack.layout.n_rows :], 62
    # λ² of the way back would be 800 rad/s². The posture asks for more than the bound's 100 rad/s².
    assert -150.0 < y[6 + elbow] < -99.9
    assert max(misses[:31].max(), misses[n_x : n_x + 31].max()) < 0.01


@pytest.mark.parametrize("level", LEVELS)
def test_one_correction_with_a_fresh_factorisation_is_the_optimum_with_limits(
    limited, wild_states, level
):
    active = 0
    # Not the wildest, in which the yielding of friction rows shows, see `_ROUNDING`.
    for state in [*wild_states[0::3], *wild_states[1::3]]:
        expected, _ = split(limited, limited.optimum(state).x)
        corrector = Corrector(
            limited.stack,
            limited.factorise(state.q),
            level=level,
            limit_rows=limited.matrices(state.q).D,
        )
        iterate, _ = limited.step(corrector, Iterate.zero(limited.stack), state)
        assert relative(iterate.y - expected, expected) < 1e-5
        contacts = len(limited.stack.contacts.l)
        active += bool((limited.optimum(state).active >= contacts).any())
    assert active >= 2


def test_corrections_come_to_rest_at_exact_torque_limits(robot, config, model, reference, rng):
    """LC: D is stale, what it keeps is exact."""
    bench = Bench(
        limited_stack(robot, config, MODES[0], kinds=LimitsConfig(torque=True), clamp=0.5),
        model,
        reference,
    )
    standing = State(robot.q_standing, np.zeros(37))
    q = standing.q.copy()
    q[7:] += 0.04 * rng.standard_normal(31)
    v = np.zeros(37)
    v[0] = 0.6
    state = State(q, v)
    corrector = Corrector(
        bench.stack,
        bench.factorise(standing.q),
        level="b",
        limit_rows=bench.matrices(standing.q).D,
    )
    iterate = Iterate.zero(bench.stack)
    for _ in range(25):
        iterate, _ = bench.step(corrector, iterate, state)
    ratio = np.abs(
        recover_torque(model, bench.stack.contacts, state.q, state.v, iterate.y)
        / (0.5 * robot.effort_limit)
    )
    # At the limit, which is 0.98 of the clamp, and missed by what the price lets through.
    assert ratio.max() == pytest.approx(0.98, abs=2e-3)


def test_the_bound_lets_a_joint_rest_before_its_limit(robot):
    """a at its bound, from any approach that the bound allows, never passes the limit."""
    kinds = LimitsConfig(position=True, position_margin=0.0)
    limits = Limits(robot, kinds, torque_clamp=1.0)
    knee, dt = 3, 1e-3
    q, v = robot.q_standing.copy(), np.zeros(37)
    v[6 + knee] = 5.0
    highest = -np.inf
    for _ in range(1000):
        _, upper = bounds(limits, robot, q, v)
        a = min(100.0, upper[31 + knee])  # driven into the limit as hard as it lets
        v[6 + knee] += dt * a
        q[7 + knee] += dt * v[6 + knee]
        highest = max(highest, q[7 + knee])
    assert highest <= robot.position_limit[1, knee] + 1e-9
    assert highest > robot.position_limit[1, knee] - 0.02


def test_a_position_goes_before_a_velocity(robot):
    limits = Limits(robot, ALL, torque_clamp=1.0)
    knee = 3
    q, v = robot.q_standing.copy(), np.zeros(37)
    q[7 + knee] = robot.position_limit[1, knee] + 0.5
    v[6 + knee] = -8.0  # back fast, which the velocity limit of 6 rad/s forbids
    lower, upper = bounds(limits, robot, q, v)
    assert lower[31 + knee] <= upper[31 + knee]
    of_position = dataclasses.replace(ALL, velocity=False)
    _, expected = bounds(Limits(robot, of_position, torque_clamp=1.0), robot, q, v)
    assert upper[31 + knee] == expected[31 + knee]


def bounds(limits, robot, q, v):
    """Lower and upper bounds, from the entries of b without torque and acceleration."""
    kinematics = Stationary(q, v)
    entries = np.empty(limits.n_entries)
    limits.write_misses(entries, kinematics)
    lower, minus_upper = np.split(entries, 2)
    return lower, -minus_upper


class Stationary:
    """A state without forces."""

    def __init__(self, q, v):
        self.q, self.v, self.a, self.force = q, v, None, np.zeros(37)
