"""Projectors with open rows, and the command of the balance law, on the wire."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest

from shared.errors import MessageRefused
from shared.wbc.answer import Openness, TimedProjector
from shared.wbc.limits import MOST_OPEN
from shared.wire.channels import DOWNLINK
from shared.wire.codec import Codec
from tests.messages import altered, make_answer, make_state


@pytest.fixture
def limited(robot, configured, motion):
    return Codec(robot, configured(**{"wbc.limits.torque": True}), motion)


@pytest.fixture
def balancing(robot, configured, motion):
    return Codec(robot, configured(**{"wbc.balance.law": "dcm"}), motion)


def answer_with(stack, rng, limits):
    """A double-support answer whose projector leaves its inequality rows open."""
    answer, k = make_answer(stack, rng), len(limits)
    opened = Openness(
        np.array(limits, dtype=int),
        rng.standard_normal((stack.layout.n_unknowns, k + stack.layout.n_forces)),
        np.tril(rng.standard_normal((k, k))),
    )
    projector = dataclasses.replace(answer.projectors[0].projector, open=opened)
    return dataclasses.replace(answer, projectors=(TimedProjector(projector, 0, 1),)), projector


@pytest.mark.parametrize("limits", [[], [0, 17, 123], list(range(MOST_OPEN))])
def test_open_rows_arrive_in_single_precision(limited, stacks, rng, limits):
    answer, sent = answer_with(stacks[0], rng, limits)
    data = limited.encode_projector(answer)
    assert len(data) <= DOWNLINK.max_bytes
    received = limited.decode_projector(data).projectors[0].projector
    rounded = limited.rounded(sent)
    np.testing.assert_array_equal(received.open.limits, limits)
    for name in ("push", "factor"):
        arrived, expected = getattr(received.open, name), getattr(rounded.open, name)
        np.testing.assert_array_equal(arrived, expected)
        np.testing.assert_allclose(arrived, getattr(sent.open, name), rtol=1e-7)
    np.testing.assert_array_equal(received.A_dagger, rounded.A_dagger)


def test_an_answer_is_the_same_when_its_form_is_known(limited, stacks, rng):
    """A receiver knows the form of an answer with so many open rows from the first one."""
    answer, _ = answer_with(stacks[0], rng, [0, 17, 123])
    data = limited.encode_projector(answer)
    repacked = altered(data, lambda fields: None)
    assert len(repacked) < len(data)
    receiver = copy.copy(limited)
    receiver._answer_forms_by_size = {}
    received = [receiver.decode_projector(each) for each in (data, data, repacked)]
    assert len(data) in receiver._answer_forms_by_size
    for each in received:
        opened, expected = each.projectors[0].projector.open, received[0].projectors[0]
        np.testing.assert_array_equal(opened.limits, expected.projector.open.limits)
        np.testing.assert_array_equal(opened.push, expected.projector.open.push)
        np.testing.assert_array_equal(opened.factor, expected.projector.open.factor)
        np.testing.assert_array_equal(each.tau, answer.tau)


@pytest.mark.parametrize(
    ("honest", "wrong", "reason"),
    [
        (bytes([0, 17, 123]), bytes([0, 17, 124]), "shape"),
        (bytes([0, 17, 123]), bytes([17, 0, 123]), "shape"),
        (np.float32(7.25).tobytes(), np.float32(np.nan).tobytes(), "not_finite"),
    ],
)
def test_errors_in_an_answer_of_its_form_are_refused(limited, stacks, rng, honest, wrong, reason):
    answer, projector = answer_with(stacks[0], rng, [0, 17, 123])
    projector.open.push[3, 4] = 7.25
    data = limited.encode_projector(answer)
    assert data.count(honest) == 1
    with pytest.raises(MessageRefused) as refused:
        limited.decode_projector(data.replace(honest, wrong))
    assert refused.value.reason == reason


@pytest.mark.parametrize("with_open_rows", [True, False])
def test_both_ends_know_whether_rows_are_open(
    limited, robot, config, motion, stacks, rng, with_open_rows
):
    """The digest of the settings differs already; the rows are checked all the same."""
    answer, _ = answer_with(stacks[0], rng, [3])
    data = limited.encode_projector(answer)
    if with_open_rows:
        reason = "config"
        receiver = Codec(robot, config, motion)
    else:
        reason = "shape"
        receiver = limited
        closed = dataclasses.replace(answer.projectors[0].projector, open=None)
        data = limited.encode_projector(
            dataclasses.replace(answer, projectors=(TimedProjector(closed, 0, 1),))
        )
    with pytest.raises(MessageRefused) as refused:
        receiver.decode_projector(data)
    assert refused.value.reason == reason


@pytest.mark.parametrize("name", ["push", "factor"])
@pytest.mark.parametrize("numbers", [b"", np.array([np.nan], np.float32).tobytes(), 7, None])
def test_other_open_rows_are_refused(limited, stacks, rng, name, numbers):
    answer, _ = answer_with(stacks[0], rng, [5])
    data = altered(
        limited.encode_projector(answer),
        lambda fields: fields["projectors"][0].update({name: numbers}),
    )
    with pytest.raises(MessageRefused) as refused:
        limited.decode_projector(data)
    assert refused.value.reason in ("shape", "not_finite")


@pytest.mark.parametrize("limits", [bytes([3, 3, 5]), bytes([5, 3, 4]), bytes([3, 5, 124]), 7])
def test_other_limits_are_refused(limited, stacks, rng, limits):
    answer, _ = answer_with(stacks[0], rng, [0, 17, 123])
    data = altered(
        limited.encode_projector(answer),
        lambda fields: fields["projectors"][0].update(limits=limits),
    )
    with pytest.raises(MessageRefused) as refused:
        limited.decode_projector(data)
    assert refused.value.reason == "shape"


def test_the_command_of_the_balance_law_arrives_to_the_last_bit(balancing, robot):
    command = np.array([1.25, -3.0 / 7.0])
    for held in (None, (3, -1, 2)):
        state = make_state(robot, com_command=command, held_sequences=held)
        received = balancing.decode_state(balancing.encode_state(state))
        np.testing.assert_array_equal(received.com_command, command)
        assert received.held_sequences == held


@pytest.mark.parametrize("command", [b"", b"x" * 8, np.array([np.nan, 0.0]).tobytes(), None])
def test_another_command_is_refused(balancing, robot, command):
    state = make_state(robot, com_command=np.zeros(2))
    data = altered(balancing.encode_state(state), lambda fields: fields.update(com_command=command))
    with pytest.raises(MessageRefused) as refused:
        balancing.decode_state(data)
    assert refused.value.reason in ("shape", "not_finite")


def test_without_a_law_a_state_has_no_command(robot, config, motion):
    codec = Codec(robot, config, motion)
    data = codec.encode_state(make_state(robot, com_command=np.zeros(2)))
    assert b"com_command" not in data
    assert codec.decode_state(data).com_command is None
