"""The robot's own limits as rows of the QP: projectors and corrections with some of them active.

The reference is the QP with all its unknowns and one violation for each limited quantity.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.config.control_settings import LimitsConfig
from shared.wbc.assisted import apply_projector
from shared.wbc.correction import Corrector, Iterate
from shared.wbc.limits import Limits
from shared.wbc.projector import full_problem, solve
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


def assisted(bench, projector, b, state):
    """The solution of a projector that the robot would use at a state, and its active set."""
    return apply_projector(bench.stack, projector, b, model=bench.model, q=state.q, v=state.v)


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
        held = solution.held
        y, _ = split(limited, expected.x)
        assert relative(held.apply(b) - y, y) < TOLERANCE
        first = len(limited.stack.contacts.l)
        both = np.concatenate([held.active, first + held.limits])
        np.testing.assert_array_equal(both, expected.active)
        assert are_independent(problem, both)
        active.append(len(held.limits))
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
        found = solve(limited.stack, matrices, b, solver=DaqpSolver())
        again = solve(
            limited.stack,
            matrices,
            b,
            solver=NoSolver(),
            likely_active=found.held.active,
            likely_limits=found.held.limits,
        )
        np.testing.assert_array_equal(again.held.A_dagger, found.held.A_dagger)
        np.testing.assert_array_equal(again.projector.open.push, found.projector.open.push)


def test_a_wrong_set_of_limits_is_not_believed(limited, wild_states):
    for state in wild_states[:4]:
        matrices, b = rows(limited, state)
        right = solve(limited.stack, matrices, b, solver=DaqpSolver()).held
        wrong = np.setxor1d(right.limits, [3, 70])
        found = solve(
            limited.stack,
            matrices,
            b,
            solver=DaqpSolver(),
            likely_active=right.active,
            likely_limits=wrong,
        )
        np.testing.assert_array_equal(found.held.A_dagger, right.A_dagger)


def test_the_robot_finds_the_optimum_from_a_projector_that_leaves_all_open(limited, wild_states):
    """LA on the projector's own state is the full QP, with the friction rows and limits active."""
    active = 0
    for state in wild_states:
        matrices, b = rows(limited, state)
        solution = solve(limited.stack, matrices, b, solver=DaqpSolver())
        expected = solution.held.apply(b)
        found = assisted(limited, solution.projector, b, state)
        assert relative(found.y - expected, expected) < 1e-7
        assert found.active_set == solution.projector.active_set
        np.testing.assert_array_equal(
            found.force[6:],
            recover_torque(limited.model, limited.stack.contacts, state.q, state.v, found.y),
        )
        active += len(solution.held.limits) > 0
    assert active >= 6


def test_a_joint_that_has_left_its_limit_is_not_thrown_back_to_it(robot, config, model, reference):
    """LA: a limit of the projector's state acts only if the present state needs it."""
    elbow = robot.model.getJointId("LElbowRoll") - 2
    highest = robot.position_limit[1, elbow] - 0.08
    posture = reference.posture.copy()
    posture[elbow] = highest
    reference = dataclasses.replace(reference, posture=posture)
    kinds = LimitsConfig(position=True)
    bench = Bench(limited_stack(robot, config, MODES[0], kinds=kinds), model, reference)
    q, v = robot.q_standing.copy(), np.zeros(37)
    q[7 + elbow], v[6 + elbow] = highest, 2.0  # towards the limit, which asks for -80 rad/s²
    matrices, b = rows(bench, State(q, v))
    solution = solve(bench.stack, matrices, b, solver=DaqpSolver())
    assert solution.held.limits.tolist() == [62 + 31 + elbow]
    # Back from the limit and at rest. Held at its bound the joint would go there at 80 rad/s².
    later = q.copy()
    later[7 + elbow] = highest - 0.2
    state = State(later, np.zeros(37))
    _, b = rows(bench, state)
    y = assisted(bench, solution.projector, b, state).y
    free = Bench(Stack(robot, config.wbc, MODES[0]), model, reference).optimum(state).x
    assert y[6 + elbow] == pytest.approx(free[6 + elbow], abs=0.1)
    assert free[6 + elbow] < 40.0


def test_with_another_velocity_a_projector_gives_the_optimum_of_that_velocity(limited, wild_states):
    """LA: friction rows and limits that have become active act, those that no longer are do not."""
    stack, changed = limited.stack, 0
    for state in wild_states:
        matrices, b = rows(limited, state)
        old = solve(stack, matrices, b, solver=DaqpSolver())
        later = State(state.q, 1.05 * state.v)
        _, b = rows(limited, later)
        fresh = solve(stack, matrices, b, solver=DaqpSolver()).held
        if not np.isin(fresh.limits, old.projector.open.limits).all():
            continue
        expected = fresh.apply(b)
        found = assisted(limited, old.projector, b, later)
        assert relative(found.y - expected, expected) < 1e-7
        held = old.held
        same = np.array_equal(fresh.limits, held.limits)
        changed += not (same and np.array_equal(fresh.active, held.active))
    assert changed >= 2


def test_an_impossible_limit_softens_before_dynamics_contacts_and_friction(
    robot, config, model, reference, wild_states
):
    # A twentieth of the torque limits does not stop a robot in motion.
    bench = Bench(limited_stack(robot, config, MODES[0], clamp=0.05), model, reference)
    state = wild_states[2]
    matrices, b = rows(bench, state)
    solution = solve(bench.stack, matrices, b, solver=DaqpSolver())
    assert solution.status is QpStatus.SOLVED
    y = solution.held.apply(b)
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
    y = solve(bench.stack, matrices, b, solver=DaqpSolver()).held.apply(b)
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


@pytest.mark.parametrize("velocity", [False, True])
def test_limits_that_clearly_hold_are_not_missed(robot, wild_states, rng, velocity):
    kinds = LimitsConfig(torque=True, position=True, velocity=velocity)
    limits = Limits(robot, kinds, torque_clamp=1.0)
    clear = unclear = 0
    for q, v in wild_states:
        a, force = 60.0 * rng.standard_normal(37), np.append(np.zeros(6), robot.effort_limit)
        force[6:] *= rng.uniform(-1.1, 1.1, size=31)
        misses = limits.misses(q, v, a, force).copy()
        for entry in range(limits.n_entries):
            if limits.clearly_hold(np.array([entry]), q, v, a, force):
                assert misses[entry] <= 1e-12
                clear += 1
            else:
                unclear += misses[entry] <= 0.0
    # Only a capped bound, or one of a velocity, is not clear.
    assert (clear == 0) if velocity else (clear > 1000 and unclear < 20)
    nothing = np.full(37, np.nan)
    assert not limits.clearly_hold(np.array([0]), q, v, a, nothing)


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
    """Lower and upper bounds, from the misses without torque and acceleration."""
    lower, minus_upper = np.split(limits.misses(q, v, None, np.zeros(len(v))).copy(), 2)
    return lower, -minus_upper
