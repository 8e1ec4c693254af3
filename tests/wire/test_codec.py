"""What is sent is what arrives. What must not arrive is in `test_refusals.py`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shared.errors import ConfigError
from shared.wbc.answer import TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wire.channels import DOWNLINK, UPLINK
from shared.wire.codec import Codec
from tests.messages import make_answer, make_projector, make_state

MODES = list(ContactMode)
# The sum of an array must stay finite for it to pass: 1e300 is far beyond any robot.
NUMBERS = st.floats(-1e300, 1e300)
TIMES = st.integers(-(2**62), 2**62)
HOLDS = st.none() | st.tuples(*[st.integers(-1, 2**63 - 1)] * len(MODES))


@pytest.fixture(scope="module")
def codec(robot, config, motion):
    return Codec(robot, config, motion)


@pytest.fixture(scope="module")
def half_codec(robot, configured, motion):
    return Codec(robot, configured(**{"wire.projector_dtype": "float32"}), motion)


def assert_same(left, right):
    """Field by field, arrays to the last bit."""
    assert type(left) is type(right)
    if dataclasses.is_dataclass(left):
        for field in dataclasses.fields(left):
            assert_same(getattr(left, field.name), getattr(right, field.name))
    elif isinstance(left, tuple):
        assert len(left) == len(right)
        for a, b in zip(left, right, strict=True):
            assert_same(a, b)
    else:
        np.testing.assert_array_equal(left, right)


@settings(max_examples=50)
@given(data=st.data())
def test_states_arrive_to_the_last_bit(data, codec, robot):
    state = make_state(
        robot,
        session=data.draw(st.integers(0, 2**32 - 1)),
        sequence=data.draw(st.integers(0, 2**40)),
        stamp_ns=data.draw(TIMES),
        time_ns=data.draw(TIMES),
        mode=data.draw(st.sampled_from(MODES)),
        q=data.draw(hnp.arrays(np.float64, robot.model.nq, elements=NUMBERS)),
        v=data.draw(hnp.arrays(np.float64, robot.model.nv, elements=NUMBERS)),
        held_sequences=data.draw(HOLDS),
    )
    assert_same(codec.decode_state(codec.encode_state(state)), state)


def test_a_robot_that_holds_nothing_is_not_one_that_wants_projectors(codec, robot):
    for held_sequences in (None, (-1, -1, -1), (0, -1, 7)):
        state = make_state(robot, held_sequences=held_sequences)
        assert codec.decode_state(codec.encode_state(state)).held_sequences == held_sequences


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    mode=st.sampled_from(MODES),
    stamp_ns=TIMES,
    scale=st.sampled_from([1e-300, 1.0, 1e5, 1e300]),
)
def test_projectors_arrive_to_the_last_bit(codec, stacks, seed, mode, stamp_ns, scale):
    rng = np.random.default_rng(seed)
    projector = make_projector(stacks[mode], rng)
    projector.A_dagger[:] *= scale
    message = make_answer(
        stacks[mode],
        rng,
        stamp_ns=stamp_ns,
        projectors=(TimedProjector(projector, stamp_ns, stamp_ns + 5),),
    )
    assert_same(codec.decode_projector(codec.encode_projector(message)), message)


def test_a_projector_may_have_no_active_rows(codec, stacks, rng):
    stack = stacks[ContactMode.LEFT_SUPPORT]
    projector = dataclasses.replace(make_projector(stack, rng), active=np.empty(0, dtype=int))
    message = make_answer(stack, rng, projectors=(TimedProjector(projector, 0, 1),))
    arrived = codec.decode_projector(codec.encode_projector(message))
    assert arrived.projectors[0].projector.active.size == 0


def test_projectors_of_several_modes_travel_together(half_codec, stacks, rng):
    double, left = stacks[ContactMode.DOUBLE_SUPPORT], stacks[ContactMode.LEFT_SUPPORT]
    message = make_answer(
        double,
        rng,
        projectors=(
            TimedProjector(make_projector(double, rng), 0, 10),
            TimedProjector(make_projector(left, rng), 10, 20),
        ),
    )
    arrived = half_codec.decode_projector(half_codec.encode_projector(message))
    assert [timed.projector.mode for timed in arrived.projectors] == [double.mode, left.mode]
    assert [timed.valid_from_ns for timed in arrived.projectors] == [0, 10]


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), mode=st.sampled_from(MODES))
def test_single_precision_rounds_the_projector_and_nothing_else(half_codec, stacks, seed, mode):
    message = make_answer(stacks[mode], np.random.default_rng(seed))
    arrived = half_codec.decode_projector(half_codec.encode_projector(message))
    sent = message.projectors[0].projector.A_dagger
    np.testing.assert_array_equal(
        arrived.projectors[0].projector.A_dagger, sent.astype(np.float32).astype(np.float64)
    )
    # Half a unit in the last of 24 bits.
    np.testing.assert_allclose(
        arrived.projectors[0].projector.A_dagger, sent, rtol=2.0**-24, atol=0.0
    )
    np.testing.assert_array_equal(arrived.y, message.y)
    np.testing.assert_array_equal(arrived.tau, message.tau)


def test_rounded_is_what_the_other_end_will_see(codec, half_codec, stacks, rng):
    for each in (codec, half_codec):
        message = make_answer(stacks[ContactMode.DOUBLE_SUPPORT], rng)
        arrived = each.decode_projector(each.encode_projector(message))
        sent = message.projectors[0].projector
        assert_same(each.rounded(sent), arrived.projectors[0].projector)


def test_either_precision_is_understood_by_either_end(codec, half_codec, stacks, rng):
    message = make_answer(stacks[ContactMode.DOUBLE_SUPPORT], rng)
    codec.decode_projector(half_codec.encode_projector(message))
    half_codec.decode_projector(codec.encode_projector(message))


def test_states_stay_below_a_kilobyte(codec, robot):
    far = 2**62
    state = make_state(
        robot,
        session=2**32 - 1,
        sequence=far,
        stamp_ns=far,
        time_ns=far,
        held_sequences=len(MODES) * (far,),
    )
    assert len(codec.encode_state(state)) <= UPLINK.max_bytes == 1_000


@pytest.mark.parametrize("mode", MODES)
def test_projectors_stay_below_forty_kilobytes(codec, half_codec, stacks, rng, mode):
    projector = dataclasses.replace(
        make_projector(stacks[mode], rng), active=np.arange(stacks[mode].layout.n_forces)
    )
    timed = TimedProjector(projector, 2**62, 2**62)
    message = make_answer(
        stacks[mode], rng, session=2**32 - 1, sequence=2**62, stamp_ns=2**62, projectors=(timed,)
    )
    size, half_size = (len(each.encode_projector(message)) for each in (codec, half_codec))
    assert size <= DOWNLINK.max_bytes == 40_000
    numbers = projector.A_dagger.size
    assert size - half_size == 4 * numbers


def test_a_message_beyond_its_channel_is_an_error_that_says_what_to_try(codec, stacks, rng):
    timed = tuple(TimedProjector(make_projector(stacks[mode], rng), 0, 1) for mode in MODES)
    message = make_answer(stacks[ContactMode.DOUBLE_SUPPORT], rng, projectors=timed)
    with pytest.raises(ConfigError, match=r"40000.*float32"):
        codec.encode_projector(message)


def test_keys_name_the_robot():
    assert UPLINK.key_for("romeo") == "wbc/romeo/state"
    assert DOWNLINK.key_for("romeo") == "wbc/romeo/projector"
