"""Every check of a received message, and that no bytes whatever raise anything else."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import MessageRefused
from shared.wbc.answer import TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wire.channels import DOWNLINK, UPLINK
from shared.wire.codec import Codec
from tests.messages import altered, make_answer, make_projector, make_state
from tests.wire.refusing import NOT_FINITE, flip, outcome, poison, reason_of


@pytest.fixture(scope="module")
def codec(robot, config, motion):
    return Codec(robot, config, motion)


@pytest.fixture(scope="module")
def state_bytes(codec, robot):
    return codec.encode_state(make_state(robot))


@pytest.fixture(scope="module")
def answer_bytes(codec, stacks):
    rng = np.random.default_rng(4)
    return codec.encode_projector(make_answer(stacks[ContactMode.DOUBLE_SUPPORT], rng))


def assert_usable(state):
    assert state.held_sequences is None or all(sequence >= -1 for sequence in state.held_sequences)
    assert np.isfinite(state.q).all()
    assert np.isfinite(state.v).all()
    assert (state.q.shape, state.v.shape) == ((38,), (37,))
    assert isinstance(state.mode, ContactMode)


def assert_applicable(message, stacks):
    assert isinstance(message.mode, ContactMode)
    assert message.tau.shape == (31,)
    assert np.isfinite(message.tau).all()
    assert message.y.shape == (stacks[message.mode].layout.n_unknowns,)
    assert np.isfinite(message.y).all()
    assert message.projectors
    for timed in message.projectors:
        layout = stacks[timed.projector.mode].layout
        assert timed.projector.A_dagger.shape == (layout.n_unknowns, layout.n_rows)
        assert np.isfinite(timed.projector.A_dagger).all()
        active = timed.projector.active
        assert np.all(np.diff(active) > 0)
        assert np.all((active >= 0) & (active < len(stacks[timed.projector.mode].contacts.l)))


def test_every_truncation_of_a_state_is_refused(codec, state_bytes):
    for length in range(len(state_bytes)):
        assert reason_of(codec.decode_state, state_bytes[:length]) == "undecodable"


def test_truncations_of_a_projector_are_refused(codec, answer_bytes):
    for length in [*range(300), *range(300, len(answer_bytes), 97), len(answer_bytes) - 1]:
        assert reason_of(codec.decode_projector, answer_bytes[:length]) == "undecodable"


def test_bytes_after_the_end_are_refused(codec, state_bytes, answer_bytes):
    assert reason_of(codec.decode_state, state_bytes + b"\0") == "undecodable"
    assert reason_of(codec.decode_projector, answer_bytes + b"\0") == "undecodable"


@settings(max_examples=300)
@given(data=st.binary(max_size=300))
def test_garbage_is_refused(codec, data):
    reason_of(codec.decode_state, data)
    reason_of(codec.decode_projector, data)


def test_every_flipped_bit_of_a_state_is_refused_or_leaves_numbers(codec, state_bytes):
    for bit in range(8 * len(state_bytes)):
        result = outcome(codec.decode_state, flip(state_bytes, bit))
        if not isinstance(result, str):
            assert_usable(result)


def test_flipped_bits_of_a_projector_are_refused_or_leave_numbers(codec, answer_bytes, stacks, rng):
    # Every bit of the header, of the fields around the matrix, and a sample of the numbers.
    header = 8 * 250
    tail = range(8 * (len(answer_bytes) - 100), 8 * len(answer_bytes))
    inside = rng.integers(header, tail.start, size=1500).tolist()
    for bit in [*range(header), *inside, *tail]:
        result = outcome(codec.decode_projector, flip(answer_bytes, bit))
        if not isinstance(result, str):
            assert_applicable(result, stacks)


@settings(max_examples=200)
@given(
    damage=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4
    )
)
def test_several_damaged_bytes_are_refused_or_leave_numbers(
    codec, state_bytes, answer_bytes, stacks, damage
):
    def damaged(data):
        data = bytearray(data)
        for where, value in damage:
            data[int(where * len(data))] = value
        return bytes(data)

    state = outcome(codec.decode_state, damaged(state_bytes))
    if not isinstance(state, str):
        assert_usable(state)
    answer = outcome(codec.decode_projector, damaged(answer_bytes))
    if not isinstance(answer, str):
        assert_applicable(answer, stacks)


SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.floats(),
    st.text(),
    st.binary(max_size=400),
)
ANYTHING = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=150)
@given(
    name=st.sampled_from(["session", "sequence", "stamp_ns", "time_ns", "mode", "q", "v"]),
    value=ANYTHING,
)
def test_a_field_of_any_other_type_is_refused(codec, state_bytes, name, value):
    data = altered(state_bytes, lambda fields: fields.update({name: value}))
    result = outcome(codec.decode_state, data)
    if not isinstance(result, str):
        assert type(value) is int
        assert getattr(result, name) == value


@settings(max_examples=150)
@given(value=ANYTHING)
def test_what_a_robot_says_to_hold_is_a_number_per_mode_or_nothing(codec, state_bytes, value):
    data = altered(state_bytes, lambda fields: fields.update(holds=value))
    result = outcome(codec.decode_state, data)
    if isinstance(result, str):
        assert result in {"shape", "oversized"}
    elif value is None:
        assert result.held_sequences is None
    else:
        assert result.held_sequences == tuple(value)
        assert all(type(sequence) is int and sequence >= -1 for sequence in value)


@pytest.mark.parametrize(
    "held_sequences",
    [
        [],
        [1, 2],
        [1, 2, 3, 4],
        [1, 2, -2],
        [1, 2, 2**63],
        [1, 2, -(2**63)],
        [1, 2, 3.0],
        [1, 2, True],
        [1, 2, None],
        [1, 2, "3"],
        [1, 2, [3]],
        {"0": 1, "1": 2, "2": 3},
        b"\x01\x02\x03",
        7,
        False,
    ],
    ids=str,
)
def test_other_things_to_hold_are_refused(codec, state_bytes, held_sequences):
    data = altered(state_bytes, lambda fields: fields.update(holds=held_sequences))
    assert reason_of(codec.decode_state, data) == "shape"


@pytest.mark.parametrize("name", ["session", "sequence", "stamp_ns", "time_ns", "mode", "q", "v"])
def test_a_state_without_a_field_is_refused(codec, state_bytes, name):
    data = altered(state_bytes, lambda fields: fields.pop(name))
    assert reason_of(codec.decode_state, data) == "shape"


@pytest.mark.parametrize(
    "name", ["session", "sequence", "stamp_ns", "mode", "tau", "y", "projectors"]
)
def test_an_answer_without_a_field_is_refused(codec, answer_bytes, name):
    data = altered(answer_bytes, lambda fields: fields.pop(name))
    assert reason_of(codec.decode_projector, data) == "shape"


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("mode", "shape"),
        ("layout", "layout"),
        ("dtype", "dtype"),
        ("active", "shape"),
        ("A_dagger", "shape"),
        ("valid_from_ns", "shape"),
        ("valid_until_ns", "shape"),
    ],
)
def test_a_projector_without_a_field_is_refused(codec, answer_bytes, name, reason):
    data = altered(answer_bytes, lambda fields: fields["projectors"][0].pop(name))
    assert reason_of(codec.decode_projector, data) == reason


@pytest.mark.parametrize("name", ["version", "kind", "config", "plan"])
def test_a_header_without_a_field_is_refused_under_its_name(codec, state_bytes, name):
    data = altered(state_bytes, lambda fields: fields.pop(name))
    assert reason_of(codec.decode_state, data) == name


def test_another_schema_version_is_refused(codec, state_bytes):
    data = altered(state_bytes, lambda fields: fields.update(version=fields["version"] + 1))
    assert reason_of(codec.decode_state, data) == "version"


def test_a_message_of_the_other_kind_is_refused(codec, state_bytes, answer_bytes):
    assert reason_of(codec.decode_projector, state_bytes) == "kind"
    data = altered(answer_bytes, lambda fields: fields.update(tau=b"", projectors=[]))
    assert reason_of(codec.decode_state, data) == "kind"


@pytest.mark.parametrize(
    "setting",
    [
        {"robot.torque_clamp": 1.0},
        {"wbc.friction": 0.4},
        {"wbc.gains.com": 11.0},
        {"wbc.weights.posture": 0.02},
        {"wbc.solver": "proxsuite"},
    ],
    ids=str,
)
def test_an_end_with_other_settings_is_refused(
    codec, robot, configured, motion, state_bytes, answer_bytes, setting
):
    other = Codec(robot, configured(**setting), motion)
    assert reason_of(other.decode_state, state_bytes) == "config"
    assert reason_of(other.decode_projector, answer_bytes) == "config"


@pytest.mark.parametrize(
    "setting",
    [
        {"seed": 3},
        {"controller": "pr"},
        {"controller": "lc"},
        {"correction.level": "c", "correction.damping": 0.05},
        {"link.loss": 0.5},
        {"loop.hold_after": 1.0},
    ],
    ids=str,
)
def test_settings_of_one_end_only_do_not_matter(robot, configured, motion, state_bytes, setting):
    Codec(robot, configured(**setting), motion).decode_state(state_bytes)


@pytest.mark.parametrize("mode", [-1, 3, 2**40])
def test_an_unknown_contact_mode_is_refused(codec, state_bytes, answer_bytes, mode):
    state = altered(state_bytes, lambda fields: fields.update(mode=mode))
    assert reason_of(codec.decode_state, state) == "mode"
    answer = altered(answer_bytes, lambda fields: fields.update(mode=mode))
    assert reason_of(codec.decode_projector, answer) == "mode"
    inner = altered(answer_bytes, lambda fields: fields["projectors"][0].update(mode=mode))
    assert reason_of(codec.decode_projector, inner) == "mode"


def test_a_projector_under_another_mode_is_refused_by_its_layout(codec, answer_bytes):
    data = altered(answer_bytes, lambda fields: fields["projectors"][0].update(mode=1))
    assert reason_of(codec.decode_projector, data) == "layout"


def test_a_projector_of_other_rows_is_refused(codec, answer_bytes):
    data = altered(answer_bytes, lambda fields: fields["projectors"][0].update(layout=b"12345678"))
    assert reason_of(codec.decode_projector, data) == "layout"


@pytest.mark.parametrize("dtype", ["float16", "<f8", "int64", "", b"float64", 8])
def test_an_unknown_number_format_is_refused(codec, answer_bytes, dtype):
    data = altered(answer_bytes, lambda fields: fields["projectors"][0].update(dtype=dtype))
    assert reason_of(codec.decode_projector, data) == "dtype"


def test_numbers_of_the_wrong_format_are_refused_by_their_length(codec, answer_bytes):
    data = altered(answer_bytes, lambda fields: fields["projectors"][0].update(dtype="float32"))
    assert reason_of(codec.decode_projector, data) == "shape"


@pytest.mark.parametrize("change", [-8, -1, 1, 8])
@pytest.mark.parametrize("name", ["q", "v"])
def test_an_array_of_another_length_is_refused(codec, state_bytes, name, change):
    def resize(fields):
        fields[name] = fields[name][:change] if change < 0 else fields[name] + bytes(change)

    assert reason_of(codec.decode_state, altered(state_bytes, resize)) == "shape"


@pytest.mark.parametrize(
    "active",
    [b"\x28", b"\x01\x01", b"\x05\x04", b"\x00\x01\x02\xff", bytes(range(25)), "text", 3, [1]],
    ids=["beyond", "twice", "unsorted", "far beyond", "too many", "text", "number", "list"],
)
def test_active_rows_that_do_not_exist_are_refused(codec, answer_bytes, active):
    data = altered(answer_bytes, lambda fields: fields["projectors"][0].update(active=active))
    assert reason_of(codec.decode_projector, data) == "shape"


@pytest.mark.parametrize("projectors", [[], None, {}, "text", 4 * [None]])
def test_a_list_of_projectors_of_the_wrong_length_or_type_is_refused(
    codec, answer_bytes, projectors
):
    data = altered(answer_bytes, lambda fields: fields.update(projectors=projectors))
    assert reason_of(codec.decode_projector, data) == "shape"


def test_a_projector_that_is_no_map_is_refused(codec, answer_bytes):
    data = altered(answer_bytes, lambda fields: fields.update(projectors=[7]))
    assert reason_of(codec.decode_projector, data) == "undecodable"


def test_an_answer_without_a_projector_of_its_own_mode_is_refused(codec, stacks, rng):
    # A purely remote robot applies the torque of the message under the mode of its projector.
    double, left = stacks[ContactMode.DOUBLE_SUPPORT], stacks[ContactMode.LEFT_SUPPORT]
    timed = TimedProjector(make_projector(double, rng), 0, 1)
    data = codec.encode_projector(make_answer(left, rng, projectors=(timed,)))
    assert reason_of(codec.decode_projector, data) in {"mode", "shape"}


@pytest.mark.parametrize("bits", NOT_FINITE.values(), ids=NOT_FINITE)
@pytest.mark.parametrize("position", [0, 17, -1])
@pytest.mark.parametrize("name", ["q", "v"])
def test_a_state_with_a_number_that_is_not_finite_is_refused(
    codec, state_bytes, name, position, bits
):
    data = altered(state_bytes, lambda fields: poison(fields, name, position, bits))
    assert reason_of(codec.decode_state, data) == "not_finite"


@pytest.mark.parametrize("bits", NOT_FINITE.values(), ids=NOT_FINITE)
@pytest.mark.parametrize("name", ["tau", "y", "A_dagger"])
def test_an_answer_with_a_number_that_is_not_finite_is_refused(codec, answer_bytes, name, bits):
    def change(fields):
        poison(fields["projectors"][0] if name == "A_dagger" else fields, name, 9, bits)

    assert reason_of(codec.decode_projector, altered(answer_bytes, change)) == "not_finite"


def test_infinities_that_cancel_are_refused(codec, state_bytes):
    def change(fields):
        poison(fields, "q", 3, NOT_FINITE["infinity"])
        poison(fields, "q", 4, NOT_FINITE["negative infinity"])

    assert reason_of(codec.decode_state, altered(state_bytes, change)) == "not_finite"


def test_a_single_precision_projector_with_a_nan_is_refused(robot, configured, motion, stacks, rng):
    codec = Codec(robot, configured(**{"wire.projector_dtype": "float32"}), motion)
    data = codec.encode_projector(make_answer(stacks[ContactMode.DOUBLE_SUPPORT], rng))
    for word in (0x7FC00000, 0x7F800001, 0x7F800000):

        def change(fields, word=word):
            entry = fields["projectors"][0]
            entry["A_dagger"] = word.to_bytes(4, "little") + entry["A_dagger"][4:]

        assert reason_of(codec.decode_projector, altered(data, change)) == "not_finite"


def test_a_message_beyond_its_channel_is_refused_unread(codec):
    assert reason_of(codec.decode_state, bytes(UPLINK.max_bytes + 1)) == "oversized"
    assert reason_of(codec.decode_projector, bytes(DOWNLINK.max_bytes + 1)) == "oversized"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc0",
        b"\xc1",
        b"\x80",
        b"\x91" * 900,
        b"\xdd\xff\xff\xff\xff",
        b"\xdf\xff\xff\xff\xff",
        b"\x81\x90\x01",
        b"\x81\x01\x01",
        b"\xd5\xff\x00\x00",
        b"\xa4\xff\xff\xff\xff",
        msgpack.packb([1, 2, 3]),
    ],
    ids=[
        "empty",
        "nil",
        "reserved byte",
        "empty map",
        "deep",
        "huge array",
        "huge map",
        "list as key",
        "number as key",
        "bad timestamp",
        "bad text",
        "list",
    ],
)
def test_odd_msgpack_is_refused(codec, data):
    expected = "version" if data == b"\x80" else "undecodable"
    assert reason_of(codec.decode_state, data) == expected
    assert reason_of(codec.decode_projector, data) == expected


def test_a_refusal_names_its_check_first():
    assert str(MessageRefused("layout", "LEFT_SUPPORT")) == "layout: LEFT_SUPPORT"
    assert str(MessageRefused("layout")) == "layout"
