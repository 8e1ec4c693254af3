"""A and b against the physics they stand for: the same numbers from Newton–Euler and kinematics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.config.settings import RunConfig
from shared.wbc.contacts import ContactMode
from shared.wbc.stack import Stack
from tests.wbc.test_tasks import target_of

# Sums of some forty products of numbers up to 1e4, compared relative to the largest.
ROUNDING = 1e-11

SIZES = {
    ContactMode.DOUBLE_SUPPORT: (56, 61),
    ContactMode.LEFT_SUPPORT: (56, 49),
    ContactMode.RIGHT_SUPPORT: (56, 49),
}


@pytest.fixture(params=list(ContactMode), ids=lambda mode: mode.name)
def stack(request, stacks):
    return stacks[request.param]


def close(actual, expected):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=ROUNDING * scale)


def test_layout_has_the_sizes_of_the_documentation(stack):
    assert (stack.layout.n_rows, stack.layout.n_unknowns) == SIZES[stack.mode]


def test_blocks_follow_each_other_and_cover_every_row_once(stack):
    covered = [
        row
        for name, _ in stack.layout.blocks
        for row in range(*stack.layout.slice(name).indices(stack.layout.n_rows))
    ]
    assert covered == list(range(stack.layout.n_rows))
    assert stack.layout.blocks[0] == ("dynamics", 6)
    assert stack.layout.blocks[-1] == ("bounds", 1)


def test_equality_and_task_rows_are_the_blocks_they_name(stack):
    layout = stack.layout
    assert stack.equality_rows == slice(0, layout.slice("contacts").stop)
    assert stack.task_rows == slice(layout.slice("com").start, layout.slice("bounds").start)


def test_an_unknown_block_is_a_key_error(stack):
    with pytest.raises(KeyError, match="toes"):
        stack.layout.slice("toes")


def test_digests_tell_the_modes_apart(stacks):
    digests = {stack.layout.digest for stack in stacks.values()}
    assert len(digests) == len(ContactMode)
    assert all(len(digest) == 8 for digest in digests)


def test_both_ends_build_the_same_digest_by_themselves(stack, robot, config):
    assert Stack(robot, config.wbc, stack.mode).layout.digest == stack.layout.digest


def test_a_changed_block_changes_the_digest(stack):
    blocks = tuple((name, size + (name == "com")) for name, size in stack.layout.blocks)
    assert dataclasses.replace(stack.layout, blocks=blocks).digest != stack.layout.digest


def test_b_has_its_terms_in_the_rows_of_their_names(stack, model, states, reference, config):
    q, v = states[1]
    kinematics = model.kinematics(q, v)
    b = stack.right_hand_side(kinematics, reference)
    assert b.shape == (stack.layout.n_rows,)
    np.testing.assert_array_equal(b[stack.layout.slice("dynamics")], -kinematics.force[:6])
    np.testing.assert_array_equal(b[stack.layout.slice("bounds")], [1.0])
    for task in stack.tasks:
        weight = getattr(config.wbc.weights, task.name)
        expected = np.sqrt(weight) * target_of(task, kinematics, reference)
        np.testing.assert_allclose(b[stack.layout.slice(task.name)], expected, rtol=1e-14)


def test_b_is_a_copy_that_a_later_call_does_not_change(stack, model, states, reference):
    b = stack.right_hand_side(model.kinematics(*states[0]), reference)
    before = b.copy()
    stack.right_hand_side(model.kinematics(*states[3]), reference)
    np.testing.assert_array_equal(b, before)


def test_dynamics_rows_are_the_base_residual_of_inverse_dynamics(
    stack, model, states, reference, rng
):
    for q, v in states:
        a = rng.standard_normal(model.nv)
        f = 50.0 * rng.standard_normal(stack.layout.n_forces)
        matrices = stack.matrices(model.jacobians(q))
        b = stack.right_hand_side(model.kinematics(q, v), reference)
        residual = matrices.E_a[:6] @ a + matrices.E_f @ f - b[:6]
        wrenches = stack.contacts.wrenches(f)
        close(residual, model.inverse_dynamics(q, v, a, wrenches)[:6])


def test_contact_rows_ask_the_soles_to_stop(stack, model, states, reference, config, rng):
    for q, v in states:
        a = rng.standard_normal(model.nv)
        kinematics = model.kinematics(q, v)
        matrices = stack.matrices(model.jacobians(q))
        b = stack.right_hand_side(kinematics, reference)
        residual = matrices.E_a[6:] @ a - b[stack.layout.slice("contacts")]
        expected = np.concatenate(
            [
                model.sole_motion(foot, q, v, a)[1]
                + config.wbc.gains.contact_damping * kinematics.sole_velocity[foot]
                for foot in stack.mode.feet
            ]
        )
        close(residual, expected)


def test_task_rows_are_weighted_differences_to_the_targets(stack, model, states, reference, rng):
    for q, v in states[:20]:
        a = rng.standard_normal(model.nv)
        kinematics, jacobians = model.kinematics(q, v), model.jacobians(q)
        b = stack.right_hand_side(kinematics, reference)
        residual = stack.matrices(jacobians).A @ a - b[stack.task_rows]
        expected = np.concatenate(
            [
                np.sqrt(task.weight)
                * (task.jacobian(jacobians) @ a - target_of(task, kinematics, reference))
                for task in stack.tasks
            ]
        )
        close(residual, expected)


def test_weights_and_gains_come_from_their_own_settings(robot, model, reference, states):
    config = RunConfig().wbc
    q, v = states[2]
    kinematics = model.kinematics(q, v)
    mode = ContactMode.DOUBLE_SUPPORT
    before = Stack(robot, config, mode).right_hand_side(kinematics, reference)
    for name in ("com", "base_orientation", "posture"):
        weights = dataclasses.replace(config.weights, **{name: 4 * getattr(config.weights, name)})
        stack = Stack(robot, dataclasses.replace(config, weights=weights), mode)
        after = stack.right_hand_side(kinematics, reference)
        rows = stack.layout.slice(name)
        # √4 of the weight on the rows of that name, nothing on the others.
        np.testing.assert_allclose(after[rows], 2.0 * before[rows], rtol=1e-14)
        np.testing.assert_array_equal(np.delete(after, rows), np.delete(before, rows))
        gains = dataclasses.replace(config.gains, **{name: 0.0})
        stack = Stack(robot, dataclasses.replace(config, gains=gains), mode)
        after = stack.right_hand_side(kinematics, reference)
        assert not np.any(np.isclose(after[rows], before[rows]))
        np.testing.assert_array_equal(np.delete(after, rows), np.delete(before, rows))


def test_contact_violation_is_zero_where_the_contact_rows_hold(stack, model, states, reference):
    for q, v in states[:20]:
        kinematics = model.kinematics(q, v)
        matrices = stack.matrices(model.jacobians(q))
        b = stack.right_hand_side(kinematics, reference)
        a = np.linalg.lstsq(matrices.E_a[6:], b[stack.layout.slice("contacts")], rcond=None)[0]
        velocity, acceleration = model.sole_motion(stack.support_foot, q, v, a)
        scale = max(1.0, np.abs(velocity).max())
        assert stack.contact_violation(velocity, acceleration) < 1e-9 * scale


def test_contact_violation_is_the_length_of_the_excess(stack, model, states):
    velocity = model.kinematics(*states[4]).sole_velocity[stack.support_foot]
    damping = -stack.contact_damping * velocity
    excess = np.array([0.0, 3.0, 0.0, 0.0, 0.0, -4.0])
    violation = stack.contact_violation(velocity, damping + excess)
    assert violation == pytest.approx(5.0, rel=1e-9)


def test_the_left_foot_is_reported_in_double_support(stacks):
    assert [stacks[mode].support_foot.value for mode in ContactMode] == ["left", "left", "right"]
