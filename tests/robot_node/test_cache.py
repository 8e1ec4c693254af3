from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robot_node.cache import CacheEntry, FactorisationCache, ProjectorCache
from robot_node.verification import FactorisationVerifier
from shared.wbc.answer import TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wire.codec import Codec
from tests.messages import (
    FOR_EVER_NS,
    make_answer,
    make_correction,
    make_factorisation,
    make_projector,
    sent_states,
)

SESSION = 5
DOUBLE, LEFT, RIGHT = ContactMode


class Anything(FactorisationVerifier):
    """A verifier for tests whose factorisations are random numbers."""

    def __init__(self):
        pass

    def check(self, factorisation, *, measured):
        pass


@pytest.fixture(scope="module")
def codec(robot, configured, motion):
    # Single precision: three modes fit into one message.
    return Codec(robot, configured(**{"wire.projector_dtype": "float32"}), motion)


@pytest.fixture
def cache(codec):
    return ProjectorCache(codec, session=SESSION)


@pytest.fixture
def answer(codec, stacks, rng):
    def encode(sequence, *, mode=DOUBLE, **changes):
        message = make_answer(
            stacks[mode], rng, **{"session": SESSION, "sequence": sequence, **changes}
        )
        return codec.encode_projector(message)

    return encode


def held(cache, mode=DOUBLE):
    entry = cache.lookup(mode, time_ns=0)
    return None if entry is None else entry.sequence


@pytest.fixture
def factorisations(codec, stacks):
    return FactorisationCache(codec, stacks, session=SESSION, level="b", verifier=Anything())


@pytest.fixture
def correction(codec, stacks, rng):
    def encode(sequence, *modes, **changes):
        message = make_correction(
            [stacks[mode] for mode in modes or (DOUBLE,)],
            rng,
            **{"session": SESSION, "sequence": sequence, **changes},
        )
        return codec.encode_factorisations(message)

    return encode


def test_an_empty_cache_has_nothing_for_any_mode(cache):
    assert [cache.lookup(mode, time_ns=0) for mode in ContactMode] == [None, None, None]


def test_the_newest_answer_is_held(cache, answer):
    assert cache.offer(answer(3), sent=sent_states())
    assert cache.offer(answer(7), sent=sent_states())
    assert held(cache) == 7
    assert not cache.refused


@pytest.mark.parametrize("late", [6, 7])
def test_an_answer_that_is_not_newer_is_stale(cache, answer, late):
    cache.offer(answer(7), sent=sent_states())
    before = cache.lookup(DOUBLE, time_ns=0)
    assert not cache.offer(answer(late), sent=sent_states(11))
    assert cache.refused == {"stale": 1}
    assert cache.lookup(DOUBLE, time_ns=0) is before


def test_the_answer_to_the_very_first_state_is_taken(cache, answer):
    assert cache.offer(answer(0), sent=sent_states(0))


def test_an_answer_to_a_state_not_sent_yet_is_from_the_future(cache, answer):
    assert not cache.offer(answer(11), sent=sent_states())
    assert cache.refused == {"future": 1}
    # It does not shut out the answers that do come.
    assert cache.offer(answer(10), sent=sent_states())


def test_the_numbers_of_a_stale_answer_are_not_looked_at(cache, codec, stacks, rng):
    good = make_answer(stacks[DOUBLE], rng, session=SESSION, sequence=7)
    data = codec.encode_projector(good)
    damaged = data.replace(good.tau.tobytes(), np.full_like(good.tau, np.nan).tobytes())
    assert not cache.offer(damaged, sent=sent_states())
    assert cache.offer(data, sent=sent_states())
    assert not cache.offer(damaged, sent=sent_states(11))
    assert cache.refused == {"not_finite": 1, "stale": 1}


def test_an_answer_to_another_start_of_the_robot_is_refused(cache, answer):
    assert not cache.offer(answer(3, session=SESSION + 1), sent=sent_states())
    assert cache.refused == {"session": 1}
    assert held(cache) is None


def test_what_the_codec_refuses_is_counted_under_its_reason(cache, answer):
    good = answer(3)
    for data in (b"", good[:-1], good[:-1], bytes(50_000), b"\x80"):
        assert not cache.offer(data, sent=sent_states())
    assert cache.refused == {"undecodable": 3, "oversized": 1, "version": 1}
    assert held(cache) is None


def test_each_mode_keeps_its_own_projector(cache, answer):
    cache.offer(answer(3, mode=DOUBLE), sent=sent_states())
    cache.offer(answer(4, mode=LEFT), sent=sent_states())
    assert held(cache, DOUBLE) == 3
    assert held(cache, LEFT) == 4
    assert held(cache, RIGHT) is None
    assert cache.lookup(LEFT, time_ns=0).projector.mode is LEFT


def test_one_answer_may_bring_projectors_of_several_modes(cache, answer, stacks, rng):
    timed = tuple(
        TimedProjector(make_projector(stacks[mode], rng), 0, FOR_EVER_NS) for mode in ContactMode
    )
    cache.offer(answer(3, projectors=timed), sent=sent_states())
    assert [held(cache, mode) for mode in ContactMode] == [3, 3, 3]
    for mode in ContactMode:
        layout = stacks[mode].layout
        projector = cache.lookup(mode, time_ns=0).projector
        assert projector.A_dagger.shape == (layout.n_unknowns, layout.n_rows)


@pytest.mark.parametrize(
    ("time_ns", "usable"), [(99, False), (100, True), (150, True), (199, True), (200, False)]
)
def test_a_projector_is_used_within_its_time_only(cache, answer, stacks, rng, time_ns, usable):
    timed = TimedProjector(make_projector(stacks[DOUBLE], rng), 100, 200)
    cache.offer(answer(3, projectors=(timed,)), sent=sent_states())
    assert (cache.lookup(DOUBLE, time_ns=time_ns) is not None) is usable


def test_the_cached_numbers_are_those_of_the_message(cache, codec, stacks, rng):
    message = make_answer(stacks[DOUBLE], rng, session=SESSION)
    cache.offer(codec.encode_projector(message), sent=sent_states())
    entry = cache.lookup(DOUBLE, time_ns=0)
    np.testing.assert_array_equal(
        entry.projector.A_dagger, message.projectors[0].projector.A_dagger.astype(np.float32)
    )
    np.testing.assert_array_equal(entry.tau, message.tau)
    np.testing.assert_array_equal(entry.y, message.y)
    assert entry.stamp_ns == message.stamp_ns
    assert cache.newest_solution is entry


def test_a_projector_of_another_mode_has_no_solution_of_its_own(cache, answer, stacks, rng):
    timed = tuple(
        TimedProjector(make_projector(stacks[mode], rng), 0, FOR_EVER_NS) for mode in ContactMode
    )
    cache.offer(answer(3, projectors=timed), sent=sent_states())
    prepared = cache.lookup(ContactMode.LEFT_SUPPORT, time_ns=0)
    assert prepared.tau is None
    assert prepared.y is None
    assert cache.newest_solution.projector.mode is DOUBLE


@pytest.mark.parametrize(("sequence", "wins"), [(2, False), (3, False), (4, True)])
def test_what_was_solved_on_board_replaces_older_answers_only(
    cache, answer, stacks, rng, sequence, wins
):
    cache.offer(answer(3), sent=sent_states())
    timed = TimedProjector(make_projector(stacks[DOUBLE], rng), 0, FOR_EVER_NS)
    cache.keep(CacheEntry(timed, sequence, 0, on_board=True))
    assert cache.lookup(DOUBLE, time_ns=0).on_board is wins


def test_a_cache_of_projectors_does_not_ask_for_factorisations(cache, answer):
    assert cache.held_sequences is None
    cache.offer(answer(3), sent=sent_states())
    assert cache.held_sequences is None


def test_an_empty_cache_of_factorisations_holds_none_and_says_so(factorisations):
    assert [factorisations.lookup(mode) for mode in ContactMode] == [None, None, None]
    assert factorisations.held_sequences == (-1, -1, -1)


def test_each_mode_keeps_its_newest_factorisation_and_the_cache_says_which(
    factorisations, correction
):
    assert factorisations.offer(correction(0, *ContactMode), sent=sent_states())
    assert factorisations.held_sequences == (0, 0, 0)
    assert factorisations.offer(
        correction(4, LEFT, stamp_ns=44), sent=sent_states(stamps_ns={4: 44})
    )
    assert factorisations.held_sequences == (0, 4, 0)
    assert factorisations.offer(correction(7, RIGHT, DOUBLE), sent=sent_states())
    assert factorisations.held_sequences == (7, 4, 7)
    entry = factorisations.lookup(LEFT)
    assert (entry.sequence, entry.stamp_ns) == (4, 44)
    assert entry.corrector.factorisation.mode is LEFT
    assert not factorisations.refused


@pytest.mark.parametrize("late", [6, 7])
def test_a_factorisation_that_is_not_newer_is_stale(factorisations, correction, late):
    factorisations.offer(correction(7), sent=sent_states())
    before = factorisations.lookup(DOUBLE)
    # Of another mode too: what a robot gets, it gets in order.
    for data in (correction(late), correction(late, LEFT)):
        assert not factorisations.offer(data, sent=sent_states())
    assert factorisations.refused == {"stale": 2}
    assert factorisations.lookup(DOUBLE) is before
    assert factorisations.lookup(LEFT) is None


def test_a_factorisation_of_a_state_not_sent_yet_is_from_the_future(factorisations, correction):
    assert not factorisations.offer(correction(11), sent=sent_states())
    assert factorisations.refused == {"future": 1}
    assert factorisations.offer(correction(10), sent=sent_states())


def test_a_factorisation_for_another_start_of_the_robot_is_refused(factorisations, correction):
    assert not factorisations.offer(correction(3, session=SESSION + 1), sent=sent_states())
    assert factorisations.refused == {"session": 1}
    assert factorisations.held_sequences == (-1, -1, -1)


def test_either_cache_refuses_what_is_for_the_other(cache, factorisations, answer, correction):
    assert not cache.offer(correction(3), sent=sent_states())
    assert not factorisations.offer(answer(3), sent=sent_states())
    assert cache.refused == {"kind": 1}
    assert factorisations.refused == {"kind": 1}


def test_a_sign_of_life_leaves_what_is_held_and_is_the_newest_answer(factorisations, correction):
    factorisations.offer(
        correction(3, *ContactMode, stamp_ns=33), sent=sent_states(stamps_ns={3: 33})
    )
    sign = make_correction([], np.random.default_rng(0), session=SESSION, sequence=7, stamp_ns=77)
    assert factorisations.offer(
        factorisations._codec.encode_factorisations(sign), sent=sent_states(stamps_ns={7: 77})
    )
    assert factorisations.held_sequences == (3, 3, 3)
    assert factorisations.newest_stamp_ns == 77


def test_the_cached_blocks_are_those_of_the_message(factorisations, codec, stacks, rng):
    message = make_correction([stacks[LEFT]], rng, session=SESSION)
    factorisations.offer(codec.encode_factorisations(message), sent=sent_states())
    cached = factorisations.lookup(LEFT).corrector.factorisation
    (sent,) = message.factorisations
    for name in ("P", "Q", "T", "posture"):
        expected = getattr(sent, name).astype(np.float32)
        np.testing.assert_array_equal(getattr(cached, name), expected)


def broken(stack, rng, *, block):
    """A well-formed factorisation whose forces have no metric."""
    factorisation = make_factorisation(stack, rng)
    forces = slice(stack.layout.n_accelerations, None)
    P = factorisation.P.copy()
    P[forces, forces] = block(stack.layout.n_forces)
    return dataclasses.replace(factorisation, P=P)


NOT_DEFINITE = {
    "zero": lambda n: np.zeros((n, n)),
    "negative": lambda n: -np.eye(n),
    "one negative": lambda n: np.diag([1.0] * (n - 1) + [-1.0]),
    "singular": lambda n: np.ones((n, n)),
    # Positive, but its inverse cannot be told from one that is not.
    "as good as singular": lambda n: np.diag([1.0] * (n - 1) + [1e-38]),
    "of no scale": lambda n: 1e-30 * np.eye(n),
}


@pytest.mark.parametrize("block", NOT_DEFINITE.values(), ids=NOT_DEFINITE)
def test_forces_that_are_not_definite_are_refused_and_leave_what_is_held(
    factorisations, codec, correction, stacks, rng, block
):
    factorisations.offer(correction(3, *ContactMode), sent=sent_states())
    before = [factorisations.lookup(mode) for mode in ContactMode]
    # A good one in the same message does not get in either.
    entries = (make_factorisation(stacks[LEFT], rng), broken(stacks[DOUBLE], rng, block=block))
    message = make_correction([], rng, session=SESSION, sequence=5, factorisations=entries)
    assert not factorisations.offer(codec.encode_factorisations(message), sent=sent_states())
    assert factorisations.refused == {"not_definite": 1}
    assert [factorisations.lookup(mode) for mode in ContactMode] == before
    assert factorisations.held_sequences == (3, 3, 3)
    # Nor does it shut out the next.
    assert factorisations.offer(correction(4), sent=sent_states())
    assert factorisations.held_sequences == (4, 3, 3)
