"""Messages of known places are msgpack, and msgpack of other places is understood."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest

from shared.wbc.contacts import ContactMode
from shared.wire.codec import Codec
from shared.wire.form import INTEGER, SMALL, Form, binary
from tests.messages import altered, make_answer, make_state
from tests.wire.test_codec import assert_same

TEMPLATE = {"kind": "a", "n": INTEGER, "inner": [{"mode": SMALL, "data": binary(3)}, None], "z": 7}


def test_what_a_form_writes_is_its_template_with_the_values():
    written = Form(TEMPLATE).write(-5, 2, b"xyz")
    assert msgpack.unpackb(written) == {
        "kind": "a",
        "n": -5,
        "inner": [{"mode": 2, "data": b"xyz"}, None],
        "z": 7,
    }


def test_a_form_reads_what_it_writes():
    form = Form(TEMPLATE)
    written = form.write(2**62, 1, b"abc")
    assert len(written) == form.size
    assert form.read(written) == (2**62, 1, b"abc")


@pytest.mark.parametrize("size", [0, 1, 255, 256, 70_000])
def test_bytes_of_any_length_have_a_place(size):
    form = Form({"data": binary(size)})
    assert msgpack.unpackb(form.write(bytes(size))) == {"data": bytes(size)}
    assert form.read(form.write(bytes(size))) == (bytes(size),)


def test_a_message_of_the_same_size_and_another_form_is_none_of_this_form():
    form, other = Form(TEMPLATE), Form({**TEMPLATE, "z": 8})
    assert other.size == form.size
    assert form.read(other.write(1, 1, b"abc")) is None


@pytest.fixture(scope="module", params=["float64", "float32"])
def codec(request, robot, configured, motion):
    return Codec(robot, configured(**{"wire.projector_dtype": request.param}), motion)


def test_states_by_msgpacks_own_encoder_are_the_same_states(codec, robot):
    for held_sequences in (None, (-1, 3, 2**40)):
        data = codec.encode_state(make_state(robot, held_sequences=held_sequences))
        repacked = altered(data, lambda fields: None)
        # Integers as short as they can be.
        assert len(repacked) < len(data)
        assert_same(codec.decode_state(repacked), codec.decode_state(data))


@pytest.mark.parametrize("mode", list(ContactMode), ids=lambda mode: mode.name)
def test_answers_by_msgpacks_own_encoder_are_the_same_answers(codec, stacks, rng, mode):
    data = codec.encode_projector(make_answer(stacks[mode], rng))
    repacked = altered(data, lambda fields: None)
    assert len(repacked) < len(data)
    assert_same(codec.decode_projector(repacked), codec.decode_projector(data))


def test_numbers_that_are_too_large_to_be_summed_arrive(codec, robot):
    state = make_state(robot, v=np.full(robot.model.nv, 1e200))
    assert_same(codec.decode_state(codec.encode_state(state)), state)
