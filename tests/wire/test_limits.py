"""Projectors with active limits of the robot, and the command of its balance law, on the wire."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.errors import MessageRefused
from shared.wbc.answer import TimedProjector
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
    """A double-support answer whose projector has columns of active limits."""
    answer = make_answer(stack, rng)
    projector = answer.projectors[0].projector
    columns = rng.standard_normal((stack.layout.n_unknowns, len(limits)))
    limited = dataclasses.replace(
        projector,
        A_dagger=np.hstack([projector.A_dagger, columns]),
        limits=np.array(limits, dtype=int),
    )
    return dataclasses.replace(answer, projectors=(TimedProjector(limited, 0, 1),)), limited


@pytest.mark.parametrize(("limits", "exact"), [([0, 17, 123], True), (list(range(40)), False)])
def test_active_limits_arrive_with_their_columns(limited, stacks, rng, limits, exact):
    """Many are sent in single precision: a message of 40 kB holds no more."""
    answer, sent = answer_with(stacks[0], rng, limits)
    data = limited.encode_projector(answer)
    assert len(data) <= DOWNLINK.max_bytes
    received = limited.decode_projector(data).projectors[0].projector
    np.testing.assert_array_equal(received.limits, limits)
    np.testing.assert_array_equal(received.A_dagger, limited.rounded(sent).A_dagger)
    assert np.array_equal(received.A_dagger, sent.A_dagger) is exact


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
