"""Factorisations on the wire: what is sent is what arrives, rounded; and what must not arrive."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.motion.plan import make_motion
from shared.wbc.contacts import ContactMode
from shared.wbc.factorisation import factorise_kkt
from shared.wire.channels import DOWNLINK
from shared.wire.codec import Codec
from tests.messages import altered, make_answer, make_correction, make_factorisation, make_state
from tests.wire.refusing import NOT_FINITE_SINGLE, flip, outcome, poison, reason_of

MODES = list(ContactMode)
DOUBLE, LEFT, RIGHT = MODES
SUBSETS = [(DOUBLE,), (LEFT,), (RIGHT,), (LEFT, DOUBLE), tuple(MODES)]
ARRAYS = ["P", "Q", "T", "A", "posture"]


@pytest.fixture(scope="module")
def codec(robot, config, motion):
    return Codec(robot, config, motion)


@pytest.fixture(scope="module")
def correction_bytes(codec, stacks):
    """One factorisation, of the robot on its left foot: 16 kB."""
    message = make_correction([stacks[LEFT]], np.random.default_rng(4))
    return codec.encode_factorisations(message)


def rounded(numbers):
    return numbers.astype(np.float32).astype(np.float64)


def assert_arrived(arrived, sent, stack):
    """All numbers rounded to single precision, once, and no others."""
    assert arrived.mode is sent.mode is stack.mode
    for name in ("P", "Q", "T", "posture"):
        numbers = getattr(arrived, name)
        np.testing.assert_array_equal(numbers, rounded(getattr(sent, name)), err_msg=name)
        assert numbers.dtype == np.float64
    varying = stack.varying_task_rows
    np.testing.assert_array_equal(arrived.A[varying], rounded(sent.A[varying]))
    # √ω has no exact single-precision value: these rows are not sent, and not rounded.
    np.testing.assert_array_equal(
        np.delete(arrived.A, varying, axis=0), np.delete(sent.A, varying, axis=0)
    )


def assert_correctable(message, stacks):
    for each in message.factorisations:
        stack = stacks[each.mode]
        n, n_e = stack.layout.n_unknowns, stack.equality_rows.stop
        n_a = stack.layout.n_accelerations
        shapes = {
            "P": (n, n),
            "Q": (n, n_e),
            "T": (n_e, n_e),
            "A": stack.constant_task_rows.shape,
            "posture": (n_a - 6,),
        }
        for name, shape in shapes.items():
            numbers = getattr(each, name)
            assert numbers.shape == shape
            assert np.isfinite(numbers).all()
        np.testing.assert_array_equal(each.P, each.P.T)
        np.testing.assert_array_equal(each.T, each.T.T)


# ---- what is sent is what arrives


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    modes=st.sampled_from(SUBSETS),
    scale=st.sampled_from([1e-30, 1.0, 1e5, 1e35]),
    session=st.integers(0, 2**32 - 1),
    stamp_ns=st.integers(-(2**62), 2**62),
)
def test_factorisations_arrive_in_single_precision(codec, stacks, seed, modes, scale, **identity):
    rng = np.random.default_rng(seed)
    message = make_correction([stacks[mode] for mode in modes], rng, sequence=17, **identity)
    for each in message.factorisations:
        for numbers in (each.P, each.Q, each.T):
            numbers *= scale
    arrived = codec.decode_factorisations(codec.encode_factorisations(message))
    assert (arrived.session, arrived.sequence) == (message.session, 17)
    assert arrived.stamp_ns == message.stamp_ns
    for received, sent in zip(arrived.factorisations, message.factorisations, strict=True):
        assert_arrived(received, sent, stacks[sent.mode])


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
def test_true_factorisations_arrive_and_can_be_used(codec, stacks, model, states, mode):
    stack = stacks[mode]
    for q, _ in states:
        matrices = stack.matrices(model.jacobians(q))
        sent = factorise_kkt(stack, matrices, q[7:], damping=0.0)
        message = dataclasses.replace(
            make_correction([], np.random.default_rng(0)), factorisations=(sent,)
        )
        (arrived,) = codec.decode_factorisations(
            codec.encode_factorisations(message)
        ).factorisations
        # P and T are symmetric but for rounding; what is sent is the lower triangle.
        symmetric = dataclasses.replace(sent, P=lower(sent.P), T=lower(sent.T))
        assert_arrived(arrived, symmetric, stack)
        # The block of the forces has eigenvalues above 0.2 even in the wildest pose: rounding of
        # entries up to 1e5 leaves it positive definite.
        forces = slice(stack.layout.n_accelerations, None)
        assert np.linalg.eigvalsh(arrived.P[forces, forces])[0] > 0.1


def lower(matrix):
    return np.tril(matrix) + np.tril(matrix, -1).T


def test_the_number_format_of_projectors_does_not_matter(robot, configured, motion, stacks, rng):
    message = make_correction([stacks[DOUBLE]], rng)
    encoded = {
        Codec(robot, configured(**{"wire.projector_dtype": dtype}), motion).encode_factorisations(
            message
        )
        for dtype in ("float32", "float64")
    }
    assert len(encoded) == 1


def test_factorisations_of_all_modes_fit_into_one_message(codec, stacks, rng):
    message = make_correction(
        stacks.values(), rng, session=2**32 - 1, sequence=2**62, stamp_ns=2**62
    )
    size = len(codec.encode_factorisations(message))
    numbers = sum(
        n * (n + 1) // 2 + n * n_e + n_e * (n_e + 1) // 2 + 37 * len(stack.varying_task_rows) + 31
        for stack in stacks.values()
        for n, n_e in [(stack.layout.n_unknowns, stack.equality_rows.stop)]
    )
    assert size <= DOWNLINK.max_bytes == 40_000
    # Names and lengths of the fields take a few hundred bytes beside the numbers.
    assert 0 < size - 4 * numbers < 500


def test_a_message_leaves_those_before_it_as_they_are(codec, stacks, rng):
    first, second = (make_correction([stacks[LEFT]], rng) for _ in range(2))
    arrived = codec.decode_factorisations(codec.encode_factorisations(first))
    codec.decode_factorisations(codec.encode_factorisations(second))
    assert_arrived(arrived.factorisations[0], first.factorisations[0], stacks[LEFT])


def test_a_message_may_have_none_and_is_a_sign_of_life_then(codec):
    message = make_correction([], np.random.default_rng(0))
    data = codec.encode_factorisations(message)
    assert codec.decode_factorisations(data) == message
    assert len(data) < 200


# ---- what must not arrive


def test_truncations_are_refused(codec, correction_bytes):
    lengths = [*range(300), *range(300, len(correction_bytes), 97), len(correction_bytes) - 1]
    for length in lengths:
        assert reason_of(codec.decode_factorisations, correction_bytes[:length]) == "undecodable"


def test_bytes_after_the_end_are_refused(codec, correction_bytes):
    assert reason_of(codec.decode_factorisations, correction_bytes + b"\0") == "undecodable"


@settings(max_examples=300)
@given(data=st.binary(max_size=300))
def test_garbage_is_refused(codec, data):
    reason_of(codec.decode_factorisations, data)


def test_flipped_bits_are_refused_or_leave_numbers(codec, correction_bytes, stacks, rng):
    # Every bit of the header, of the fields around the arrays, and a sample of the numbers.
    header = 8 * 250
    tail = range(8 * (len(correction_bytes) - 150), 8 * len(correction_bytes))
    inside = rng.integers(header, tail.start, size=1500).tolist()
    for bit in [*range(header), *inside, *tail]:
        result = outcome(codec.decode_factorisations, flip(correction_bytes, bit))
        if not isinstance(result, str):
            assert_correctable(result, stacks)


@settings(max_examples=200)
@given(
    damage=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4
    )
)
def test_several_damaged_bytes_are_refused_or_leave_numbers(
    codec, correction_bytes, stacks, damage
):
    data = bytearray(correction_bytes)
    for where, value in damage:
        data[int(where * len(data))] = value
    result = outcome(codec.decode_factorisations, bytes(data))
    if not isinstance(result, str):
        assert_correctable(result, stacks)


def test_a_message_of_another_kind_is_refused(codec, robot, stacks, rng, correction_bytes):
    state = codec.encode_state(make_state(robot))
    answer = codec.encode_projector(make_answer(stacks[DOUBLE], rng))
    assert reason_of(codec.decode_factorisations, state) == "kind"
    assert reason_of(codec.decode_factorisations, answer) == "kind"
    assert reason_of(codec.decode_projector, correction_bytes) == "kind"
    small = altered(correction_bytes, lambda fields: fields.update(factorisations=[]))
    assert reason_of(codec.decode_state, small) == "kind"


@pytest.mark.parametrize("name", ["version", "kind", "config", "plan"])
def test_a_header_without_a_field_is_refused_under_its_name(codec, correction_bytes, name):
    data = altered(correction_bytes, lambda fields: fields.pop(name))
    assert reason_of(codec.decode_factorisations, data) == name


def test_an_end_with_other_settings_or_another_plan_is_refused(
    robot, configured, motion, correction_bytes
):
    other = Codec(robot, configured(**{"wbc.friction": 0.4}), motion)
    assert reason_of(other.decode_factorisations, correction_bytes) == "config"
    walk = make_motion(robot, configured(task="walk"))
    elsewhere = Codec(robot, configured(), walk)
    assert reason_of(elsewhere.decode_factorisations, correction_bytes) == "plan"


@pytest.mark.parametrize(
    "setting",
    [{"controller": "lc"}, {"correction.level": "c"}, {"correction.damping": 0.05}],
    ids=str,
)
def test_settings_of_one_end_only_do_not_matter(
    robot, configured, motion, correction_bytes, setting
):
    Codec(robot, configured(**setting), motion).decode_factorisations(correction_bytes)


@pytest.mark.parametrize("name", ["session", "sequence", "stamp_ns", "factorisations"])
def test_a_message_without_a_field_is_refused(codec, correction_bytes, name):
    data = altered(correction_bytes, lambda fields: fields.pop(name))
    assert reason_of(codec.decode_factorisations, data) == "shape"


@pytest.mark.parametrize(
    ("name", "reason"), [("mode", "shape"), ("layout", "layout"), *((a, "shape") for a in ARRAYS)]
)
def test_a_factorisation_without_a_field_is_refused(codec, correction_bytes, name, reason):
    data = altered(correction_bytes, lambda fields: fields["factorisations"][0].pop(name))
    assert reason_of(codec.decode_factorisations, data) == reason


@pytest.mark.parametrize("factorisations", [None, {}, "text", 4 * [None]], ids=str)
def test_a_list_of_the_wrong_length_or_type_is_refused(codec, correction_bytes, factorisations):
    data = altered(correction_bytes, lambda f: f.update(factorisations=factorisations))
    assert reason_of(codec.decode_factorisations, data) == "shape"


@pytest.mark.parametrize("entry", [7, None, "text", []], ids=str)
def test_a_factorisation_that_is_no_map_is_refused(codec, correction_bytes, entry):
    data = altered(correction_bytes, lambda fields: fields.update(factorisations=[entry]))
    assert reason_of(codec.decode_factorisations, data) == "undecodable"


@pytest.mark.parametrize("mode", [-1, 3, 2**40])
def test_an_unknown_contact_mode_is_refused(codec, correction_bytes, mode):
    data = altered(correction_bytes, lambda f: f["factorisations"][0].update(mode=mode))
    assert reason_of(codec.decode_factorisations, data) == "mode"


@pytest.mark.parametrize("mode", [DOUBLE, RIGHT], ids=lambda mode: mode.name)
def test_a_factorisation_under_the_name_of_another_mode_is_refused(codec, correction_bytes, mode):
    # On the right foot all shapes are the same: only the layout tells.
    data = altered(correction_bytes, lambda f: f["factorisations"][0].update(mode=int(mode)))
    assert reason_of(codec.decode_factorisations, data) == "layout"


@pytest.mark.parametrize("layout", [bytes(8), b"", None, "text", 3], ids=str)
def test_another_layout_is_refused(codec, correction_bytes, layout):
    data = altered(correction_bytes, lambda f: f["factorisations"][0].update(layout=layout))
    assert reason_of(codec.decode_factorisations, data) == "layout"


@pytest.mark.parametrize("change", [-4, -1, 1, 4])
@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_another_length_is_refused(codec, correction_bytes, name, change):
    def resize(fields):
        entry = fields["factorisations"][0]
        entry[name] = entry[name][:change] if change < 0 else entry[name] + bytes(change)

    data = altered(correction_bytes, resize)
    assert reason_of(codec.decode_factorisations, data) == "shape"


@pytest.mark.parametrize("value", ["text", [1.0], 3, None], ids=str)
@pytest.mark.parametrize("name", ARRAYS)
def test_what_is_no_array_is_refused(codec, correction_bytes, name, value):
    data = altered(correction_bytes, lambda f: f["factorisations"][0].update({name: value}))
    assert reason_of(codec.decode_factorisations, data) == "shape"


@pytest.mark.parametrize("bits", NOT_FINITE_SINGLE.values(), ids=NOT_FINITE_SINGLE)
@pytest.mark.parametrize("position", [0, 17, -1])
@pytest.mark.parametrize("name", ARRAYS)
def test_a_number_that_is_not_finite_is_refused(codec, correction_bytes, name, position, bits):
    def change(fields):
        poison(fields["factorisations"][0], name, position, bits, words="<u4")

    data = altered(correction_bytes, change)
    assert reason_of(codec.decode_factorisations, data) == "not_finite"


def test_a_number_beyond_single_precision_is_refused_by_the_receiver(codec, stacks, rng):
    factorisation = make_factorisation(stacks[LEFT], rng)
    factorisation.Q[3, 3] = 1e39
    message = dataclasses.replace(make_correction([], rng), factorisations=(factorisation,))
    with np.errstate(over="ignore"):
        data = codec.encode_factorisations(message)
    assert reason_of(codec.decode_factorisations, data) == "not_finite"


def test_one_bad_factorisation_of_several_refuses_the_message(codec, stacks, rng):
    good = codec.encode_factorisations(make_correction(stacks.values(), rng))
    data = altered(good, lambda fields: fields["factorisations"][2].update(layout=bytes(8)))
    assert reason_of(codec.decode_factorisations, data) == "layout"


def test_a_message_beyond_its_channel_is_refused_unread(codec):
    assert reason_of(codec.decode_factorisations, bytes(DOWNLINK.max_bytes + 1)) == "oversized"
