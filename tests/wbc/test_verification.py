"""Which factorisations are the inverse of a KKT matrix, and how small an error is still seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.config.control_settings import LimitsConfig
from shared.wbc.answer import Openness
from shared.wbc.contacts import ContactMode
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.limits import Limits
from shared.wbc.projector import leave_open
from shared.wbc.stack import Stack
from shared.wbc.verification import InverseTest, OpenRowsTest

MODES = list(ContactMode)
BLOCKS = ("P", "Q", "T", "A")


def sent(factorisation, **changes):
    """The blocks as they arrive: in single precision."""
    blocks = {name: getattr(factorisation, name) for name in BLOCKS} | changes
    rounded = {name: np.float64(np.float32(block)) for name, block in blocks.items()}
    return dataclasses.replace(factorisation, **rounded)


@pytest.fixture
def make(stacks, model, robot, rng):
    """The matrices of a mode, their factorisation and its test, some way from standing."""

    def build(mode, *, spread=0.2, damping=0.0):
        q = robot.q_standing.copy()
        q[7:] += spread * rng.standard_normal(len(q) - 7)
        matrices = stacks[mode].matrices(model.jacobians(q))
        factorisation = factorise_kkt(stacks[mode], matrices, q[7:], damping=damping)
        return matrices, factorisation, InverseTest(stacks[mode], damping=damping, rng=rng)

    return build


@pytest.mark.parametrize("damping", [0.0, 0.1])
@pytest.mark.parametrize("spread", [0.0, 0.05, 0.3, 1.0])
@pytest.mark.parametrize("mode", MODES)
def test_what_an_honest_edge_sends_passes(make, mode, spread, damping):
    for _ in range(5):
        matrices, factorisation, test = make(mode, spread=spread, damping=damping)
        assert test.passes(matrices, sent(factorisation))


@pytest.mark.parametrize("task_weight", [1e-1, 1e-4])
def test_light_tasks_make_rounding_larger_and_the_test_coarser(
    robot, config, model, rng, task_weight
):
    weights = dataclasses.replace(config.wbc.weights, posture=task_weight)
    stack = Stack(robot, dataclasses.replace(config.wbc, weights=weights), MODES[1])
    matrices = stack.matrices(model.jacobians(robot.q_standing))
    factorisation = factorise_kkt(stack, matrices, robot.q_standing[7:])
    test = InverseTest(stack, damping=0.0, rng=rng)
    assert test.passes(matrices, sent(factorisation))
    assert not test.passes(matrices, sent(factorisation, P=-factorisation.P))


@pytest.mark.parametrize("scale", [-1.0, 0.0, 1e-6, 0.5, 0.95, 1.05, 2.0, 1e6, 1e30])
@pytest.mark.parametrize("name", BLOCKS)
@pytest.mark.parametrize("mode", MODES)
def test_a_scaled_block_is_refused(make, mode, name, scale):
    matrices, factorisation, test = make(mode)
    assert not test.passes(
        matrices, sent(factorisation, **{name: scale * getattr(factorisation, name)})
    )


@pytest.mark.parametrize("name", BLOCKS)
@pytest.mark.parametrize("mode", MODES)
def test_a_block_with_two_rows_exchanged_is_refused(make, mode, name, rng):
    matrices, factorisation, test = make(mode)
    block = getattr(factorisation, name)
    for _ in range(10):
        i, j = rng.choice(len(block), size=2, replace=False)
        exchanged = block.copy()
        exchanged[[i, j]] = block[[j, i]]
        if np.abs(exchanged - block).max() > 0.1 * np.abs(block).max():
            assert not test.passes(matrices, sent(factorisation, **{name: exchanged}))


@pytest.mark.parametrize("mode", MODES)
def test_the_blocks_of_another_posture_are_refused(make, mode):
    matrices, _, test = make(mode)
    for spread in (0.01, 0.1, 1.0):
        _, other, _ = make(mode, spread=spread)
        assert not test.passes(matrices, sent(other))


def test_the_blocks_of_the_other_foot_are_refused(make, stacks, model, robot):
    left, right = ContactMode.LEFT_SUPPORT, ContactMode.RIGHT_SUPPORT
    matrices, _, test = make(left, spread=0.0)
    other = factorise_kkt(
        stacks[right],
        stacks[right].matrices(model.jacobians(robot.q_standing)),
        robot.q_standing[7:],
    )
    assert not test.passes(matrices, sent(other))


@pytest.mark.parametrize("size", [1e30, 1e150, 1e300])
def test_numbers_that_overflow_are_refused(make, size):
    matrices, factorisation, test = make(MODES[0])
    huge = dataclasses.replace(factorisation, P=size * factorisation.P, T=size * factorisation.T)
    assert not test.passes(matrices, huge)


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("name", BLOCKS)
def test_a_single_number_that_is_not_finite_is_refused(make, name, number):
    matrices, factorisation, test = make(MODES[0])
    block = getattr(factorisation, name).copy()
    block[0, 0] = number
    assert not test.passes(matrices, dataclasses.replace(factorisation, **{name: block}))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["P", "Q", "T"])
def test_the_power_of_the_test_ends_at_a_part_in_a_thousand(make, mode, name, rng):
    """Errors of a tenth of the tolerance are not seen, and those of ten times are.

    Sizes are those of K X − I, in the scale of the test. A corrector forgets a part in a hundred of
    its error less per tick: such a factorisation is as good as the exact one.
    """
    matrices, factorisation, test = make(mode)
    block = getattr(factorisation, name)
    error = rng.standard_normal(block.shape) * np.abs(block)
    if name != "Q":
        error = 0.5 * (error + error.T)

    def passes(size):
        return test.passes(matrices, sent(factorisation, **{name: block + size * error}))

    sizes = 10.0 ** np.arange(-8.0, 0.5, 0.5)
    seen = [not passes(size) for size in sizes]
    # One limit: what is seen at a size is seen at every larger one.
    assert seen == sorted(seen)
    assert not seen[0]
    assert sizes[seen.index(True)] <= 0.1


# ---- Projectors with open rows


@pytest.fixture
def make_open(robot, config, model, rng):
    """The matrices of a mode with limits, a projector that leaves `k` of them open, as it arrives,
    and its test.
    """
    limits = Limits(robot, LimitsConfig(torque=True, position=True), torque_clamp=1.0)

    def build(mode, *, spread=0.2, k=9):
        stack = Stack(robot, config.wbc, mode, limits)
        q = robot.q_standing.copy()
        q[7:] += spread * rng.standard_normal(len(q) - 7)
        matrices = stack.matrices(model.jacobians(q))
        # Of each quantity at most one bound.
        chosen = rng.choice(62, size=k, replace=False) + 62 * rng.integers(2, size=k)
        projector = leave_open(
            stack, stack.least_norm(matrices), np.arange(3), np.sort(chosen.astype(int))
        )
        return matrices, in_single(projector), OpenRowsTest(stack, rng=rng)

    return build


def in_single(projector, **changes):
    arrays = {
        "A_dagger": projector.A_dagger,
        "push": projector.open.push,
        "factor": projector.open.factor,
    }
    rounded = {
        name: np.asarray(each, np.float32).astype(float)
        for name, each in (arrays | changes).items()
    }
    opened = Openness(projector.open.limits, rounded["push"], rounded["factor"])
    return dataclasses.replace(projector, A_dagger=rounded["A_dagger"], open=opened)


@pytest.mark.parametrize("k", [0, 1, 40])
@pytest.mark.parametrize("spread", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("mode", MODES)
def test_open_rows_of_an_honest_edge_pass(make_open, mode, spread, k):
    for _ in range(3):
        matrices, projector, test = make_open(mode, spread=spread, k=k)
        assert test.passes(matrices, projector)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["A_dagger", "push", "factor"])
def test_an_error_of_a_part_in_a_hundred_in_open_rows_is_refused(make_open, mode, name, rng):
    matrices, projector, test = make_open(mode)
    array = projector.A_dagger if name == "A_dagger" else getattr(projector.open, name)
    sizes = 10.0 ** np.arange(-8.0, 0.5, 0.5)
    error = rng.standard_normal(array.shape) * np.abs(array)
    seen = [
        not test.passes(matrices, in_single(projector, **{name: array + size * error}))
        for size in sizes
    ]
    assert seen == sorted(seen)
    assert not seen[0]
    assert sizes[seen.index(True)] <= 0.01
    for scale in (-1.0, 0.0, 0.95, 1e6, 1e30, np.nan):
        assert not test.passes(matrices, in_single(projector, **{name: scale * array}))


def test_a_single_wrong_column_of_the_pushes_is_refused(make_open):
    matrices, projector, test = make_open(MODES[0])
    for column in range(projector.open.push.shape[1]):
        push = projector.open.push.copy()
        # A column alone may have another sign, as u has.
        push[:, column] += 0.5 * push[:, column - 1]
        assert not test.passes(matrices, in_single(projector, push=push))


def test_open_rows_of_another_posture_are_refused(make_open):
    matrices, _, test = make_open(MODES[0])
    for spread in (0.01, 0.1, 1.0):
        _, other, _ = make_open(MODES[0], spread=spread)
        assert not test.passes(matrices, other)
