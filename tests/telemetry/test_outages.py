"""Outages from messages: what is one, what is not, and where it begins and ends."""

from __future__ import annotations

import numpy as np

from shared.telemetry.outages import OUTAGE, PASSING, LinkLane

MILLISECOND = 1_000_000


def lane_of(
    sent_ms: np.ndarray, delay_ms: np.ndarray, *, batches: int = 1, steady: bool = False
) -> list[tuple[int, str]]:
    """Changes [ms] after the first, from messages that come in so many batches."""
    sent_ns, delay_ns = sent_ms * MILLISECOND, delay_ms * MILLISECOND
    lane, changes = LinkLane(steady=steady), []
    for k in np.array_split(np.arange(len(sent_ms)), batches):
        changes += lane.add(sent_ns[k], delay_ns[k])
    return [(at_ns // MILLISECOND, state) for at_ns, state in changes[1:]]


def test_a_stall_is_from_the_last_arrival_before_it_to_the_first_after_it() -> None:
    sent = np.arange(400)
    delay = np.full(400, 5)
    delay[100:300] = 305 - sent[100:300]
    for batches in (1, 7):
        assert lane_of(sent, delay, batches=batches) == [(105, OUTAGE), (305, PASSING)]


def test_a_constant_delay_is_no_outage_however_large() -> None:
    assert lane_of(np.arange(300), np.full(300, 1000), batches=3) == []


def test_a_sender_that_has_nothing_to_say_is_no_outage() -> None:
    sent = np.array([0, 10, 900, 2500])
    assert lane_of(sent, np.full(4, 20)) == []


def test_one_late_message_of_a_sparse_sender_is_an_outage_beyond_the_least_delay() -> None:
    assert lane_of(np.array([0, 1000]), np.array([20, 220])) == [(1020, OUTAGE), (1220, PASSING)]


def test_lost_messages_are_passed_over() -> None:
    sent, delay = np.arange(100), np.full(100, 5)
    delay[40:60] = -1
    assert lane_of(sent, delay) == []
    assert LinkLane().add(np.array([5]), np.array([-1])) == []


def test_of_a_steady_sender_a_time_in_which_all_was_lost_is_an_outage() -> None:
    sent, delay = np.arange(400), np.full(400, 5)
    delay[100:300] = -1
    for batches in (1, 7, 400):
        assert lane_of(sent, delay, batches=batches, steady=True) == [(105, OUTAGE), (305, PASSING)]
    assert lane_of(sent, delay) == []


def test_losses_that_are_known_before_what_is_under_way_end_with_what_follows_them() -> None:
    """At a delay of 500 ms, losses are reported among messages that were sent long before."""
    lane = LinkLane(steady=True)
    delay = np.full(300, 500)
    lost = np.full(300, -1)
    before, during, after = (np.arange(300) + begin for begin in (0, 300, 600))
    message = lane.add(before[:1] * MILLISECOND, delay[:1] * MILLISECOND)
    for sent_ms, delay_ms in ((during, lost), (before[1:], delay[1:]), (after, delay)):
        message += lane.add(sent_ms * MILLISECOND, delay_ms * MILLISECOND)
    changes = [(at_ns // MILLISECOND, state) for at_ns, state in message[1:]]
    assert changes == [(800, OUTAGE), (1100, PASSING)]


def test_a_steady_sender_that_pauses_is_no_outage() -> None:
    sent = np.append(np.arange(100), np.arange(400, 500))
    assert lane_of(sent, np.full(200, 5), steady=True) == []


def test_an_outage_that_was_told_as_a_silence_is_not_told_again() -> None:
    lane = LinkLane()
    lane.add(np.arange(100) * MILLISECOND, np.full(100, 5 * MILLISECOND))
    assert len(lane.silent(10**9, OUTAGE, patience_ns=0)) == 1
    sent_ns, delay_ns = np.array([100, 900])[:, None] * MILLISECOND
    assert lane.add(sent_ns, delay_ns) == [(10**9, PASSING)]


def test_a_silence_is_told_once_and_ends_with_the_next_message() -> None:
    lane = LinkLane()
    assert lane.silent(10**12, OUTAGE, patience_ns=0) == [], "nothing has begun yet"
    lane.add(np.array([0]), np.array([5]))
    assert lane.silent(100, OUTAGE, patience_ns=200) == []
    assert lane.silent(300, OUTAGE, patience_ns=200) == [(5, OUTAGE)]
    assert lane.silent(400, OUTAGE, patience_ns=200) == []
    assert lane.add(np.array([500]), np.array([5])) == [(505, PASSING)]


def test_an_outage_that_loses_messages_is_known_while_it_lasts() -> None:
    lane = LinkLane(steady=True)
    sent, delay = np.arange(400), np.full(400, 5)
    delay[100:300] = -1
    told, changes = [], []
    for k in np.array_split(np.arange(400), 40):
        changes += lane.add(sent[k] * MILLISECOND, delay[k] * MILLISECOND)
        told += [(int(k[-1]), at_ns // MILLISECOND, state) for at_ns, state in lane.lasting()]
    assert told == [(159, 105, OUTAGE)]
    assert [(at_ns // MILLISECOND, state) for at_ns, state in changes[1:]] == [(305, PASSING)]


def test_messages_under_way_when_others_are_lost_are_no_outage() -> None:
    """At a delay of 500 ms the link still passes messages for 500 ms after a cut."""
    lane = LinkLane(steady=True)
    lane.add(np.arange(1) * MILLISECOND, np.full(1, 500 * MILLISECOND))
    lane.add(np.arange(300, 800) * MILLISECOND, np.full(500, -1))
    assert lane.lasting() == []
    lane.add(np.arange(800, 900) * MILLISECOND, np.full(100, -1))
    assert lane.lasting() == [(800 * MILLISECOND, OUTAGE)]
