"""Benches of every contact mode, and pairs of states and stale configurations."""

from __future__ import annotations

import numpy as np
import pytest

from tests.states import random_state
from tests.wbc.correction_bench import DISTANCE, DOUBLE, MODES, Bench


@pytest.fixture(params=MODES, ids=lambda mode: mode.name)
def bench(request, stacks, model, reference):
    return Bench(stacks[request.param], model, reference)


@pytest.fixture
def double(stacks, model, reference):
    return Bench(stacks[DOUBLE], model, reference)


@pytest.fixture(scope="module")
def pairs(robot):
    """States, and configurations that some other joint angles and no other base are away."""
    rng = np.random.default_rng(7)
    result = []
    for _ in range(12):
        state = random_state(robot, spread=0.05, rng=rng)
        q = state.q.copy()
        q[7:] += rng.uniform(-DISTANCE, DISTANCE, size=len(q) - 7)
        result.append((state, q))
    return result
