"""The task of the angular momentum in the QP, at both ends of the link."""

from __future__ import annotations

import numpy as np
import pytest

from shared.wbc.projector import solve
from shared.wbc.qp import DaqpSolver
from shared.wbc.stack import Stack
from tests.wbc.correction_bench import LEVELS, MODES, TOLERANCE, Bench, relative

WEIGHT = {"wbc.weights.angular_momentum": 0.5}


@pytest.fixture(params=MODES, ids=lambda mode: mode.name)
def turning(request, robot, configured, model, reference):
    return Bench(Stack(robot, configured(**WEIGHT).wbc, request.param), model, reference)


def test_without_a_weight_there_is_no_row(stacks):
    for stack in stacks.values():
        assert "angular_momentum" not in dict(stack.layout.blocks)


def test_the_projector_reproduces_the_full_qp(turning, states):
    for state in states[:12]:
        b = turning.stack.right_hand_side(turning.model.kinematics(*state), turning.reference)
        projector = solve(
            turning.stack, turning.matrices(state.q), b, solver=DaqpSolver()
        ).projector
        expected = turning.optimum(state).x
        assert relative(projector.apply(b) - expected, expected) < TOLERANCE


@pytest.mark.parametrize("level", LEVELS)
def test_one_correction_with_a_fresh_factorisation_is_the_optimum(turning, pairs, level):
    for state, _ in pairs[:4]:
        expected = turning.optimum(state).x
        iterate = turning.converged(turning.factorise(state.q), state, level=level, steps=1)
        assert relative(iterate.y - expected, expected) < TOLERANCE


def test_a_larger_weight_brings_the_rate_of_the_momentum_closer_to_what_is_asked(
    robot, configured, model, reference, pairs
):
    state, _ = pairs[0]
    misses = []
    for weight in (1e-6, 0.1, 10.0):
        config = configured(**{"wbc.weights.angular_momentum": weight})
        bench = Bench(Stack(robot, config.wbc, MODES[0]), model, reference)
        _, residual = bench.linearised(state, bench.optimum(state).x)
        rows = bench.stack.layout.slice("angular_momentum")
        misses.append(np.linalg.norm(residual[rows]) / np.sqrt(weight))
    assert misses[2] < 0.1 * misses[1] < 0.1 * misses[0]
