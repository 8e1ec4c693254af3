from __future__ import annotations

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.bus.base import (
    Delivery,
    Envelope,
    Inbox,
    ReceptionCounter,
    RefusalCounter,
    SenderCounter,
    new_session,
)

FORGED = 2**31
WORD = st.integers(0, 2**32 - 1)


def message(sequence, *, session=1, data=None):
    payload = f"{session}/{sequence}".encode() if data is None else data
    return Delivery(payload, Envelope(session, sequence, sent_ns=0, clock=0))


@given(session=WORD, sequence=WORD, sent_ns=st.integers(-(2**63), 2**63 - 1), clock=WORD)
def test_envelopes_arrive_as_they_were_sent_in_twenty_bytes(session, sequence, sent_ns, clock):
    envelope = Envelope(session, sequence, sent_ns, clock)
    assert len(envelope.encode()) == 20
    assert Envelope.decode(envelope.encode()) == envelope


@pytest.mark.parametrize("data", [None, b"", bytes(19), bytes(21)])
def test_other_bytes_are_no_envelope(data):
    assert Envelope.decode(data) is None


def test_sessions_differ_and_fit_their_field():
    sessions = {new_session() for _ in range(100)}
    assert len(sessions) == 100
    assert all(0 <= session < 2**32 for session in sessions)


def count(*envelopes):
    counter = ReceptionCounter()
    for envelope in envelopes:
        counter.count(envelope, 0)
    return counter


def numbered(*sequences, session=1):
    return [Envelope(session, sequence, 0, 0) for sequence in sequences]


def test_nothing_is_lost_of_an_unbroken_sequence():
    counter = count(*numbered(*range(7, 30)))
    assert (counter.received, counter.lost) == (23, 0)


def test_a_gap_is_lost():
    assert count(*numbered(1, 2, 5, 6, 9)).lost == 4


def test_an_overtaken_message_is_not_lost():
    assert count(*numbered(0, 3, 1, 2, 4)).lost == 0


def test_a_gap_is_lost_until_it_is_filled():
    counter = count(*numbered(0, 2))
    assert counter.lost == 1
    counter.count(numbered(1)[0], 0)
    assert counter.lost == 0


def test_what_was_sent_before_the_first_arrival_is_not_counted():
    assert count(*numbered(1000, 1001)).lost == 0


@pytest.mark.parametrize("sequences", [(0, FORGED, 1), (FORGED, 0, 1), (0, FORGED, FORGED + 1, 1)])
def test_a_forged_number_is_no_loss(sequences):
    assert count(*numbered(*sequences)).lost == 0


def test_losses_before_and_after_a_forged_number_are_counted():
    assert count(*numbered(0, 3, FORGED, 4, 6)).lost == 2 + 1


@pytest.mark.parametrize("silent_ms", [5, 5000])
def test_every_loss_of_a_long_outage_is_counted(silent_ms):
    counter = count(*numbered(0))
    counter.count(numbered(silent_ms)[0], silent_ms * 1_000_000)
    assert counter.lost == silent_ms - 1


def test_messages_that_an_outage_has_held_back_are_of_one_sequence():
    # All arrive at its end, the first one too.
    assert count(*numbered(*range(3000), 3500)).lost == 500


def test_publishers_are_counted_apart():
    first, second = numbered(0, 2, session=1), numbered(500, 501, 504, session=2)
    interleaved = [first[0], second[0], second[1], first[1], second[2]]
    counter = count(*interleaved)
    assert (counter.received, counter.lost) == (5, 1 + 2)


def test_a_message_without_an_envelope_is_received_and_of_no_sequence():
    counter = count(None, *numbered(0, 1), None)
    assert (counter.received, counter.lost) == (4, 0)


@given(sent=st.integers(2, 60), kept=st.sets(st.integers(0, 59), min_size=1), order=st.randoms())
def test_losses_are_the_numbers_missing_between_the_first_and_the_last(sent, kept, order):
    arrived = sorted(sequence for sequence in kept if sequence < sent)
    if not arrived:
        return
    shuffled = arrived.copy()
    order.shuffle(shuffled)
    expected = arrived[-1] - arrived[0] + 1 - len(arrived)
    assert count(*numbered(*shuffled)).lost == expected


def taken(inbox):
    return [delivery.data for delivery in inbox.take()]


def test_an_inbox_keeps_the_newest_of_a_burst():
    inbox = Inbox()
    for sequence in (3, 9, 5):
        inbox.put(message(sequence))
    assert taken(inbox) == [b"1/9"]
    assert inbox.counter.received == 3


def test_an_inbox_gives_a_message_once():
    inbox = Inbox()
    inbox.put(message(1))
    assert taken(inbox) == [b"1/1"]
    assert not inbox.take()


def test_an_inbox_keeps_the_newest_of_each_publisher():
    inbox = Inbox()
    for sequence in (900, 901):
        inbox.put(message(sequence, session=1))
    for sequence in (0, 1):
        inbox.put(message(sequence, session=2))
    assert sorted(taken(inbox)) == [b"1/901", b"2/1"]


def test_many_publishers_do_not_grow_an_inbox():
    inbox = Inbox()
    for session in range(10_000):
        inbox.put(message(1, session=session))
    assert 1 <= len(inbox.take()) <= 8
    assert inbox.counter.received == 10_000
    assert len(inbox.counter._spans) <= 1024


def test_a_crowd_does_not_keep_the_newest_of_a_known_publisher_out():
    inbox = Inbox()
    inbox.put(message(1, session=7))
    for session in range(100, 200):
        inbox.put(message(1, session=session))
    inbox.put(message(2, session=7))
    assert b"7/2" in taken(inbox)


def test_strangers_are_passed_on_to_be_refused_but_bounded():
    inbox = Inbox()
    inbox.put(message(1))
    for k in range(1000):
        inbox.put(Delivery(b"stranger %d" % k, None))
    messages = taken(inbox)
    assert b"1/1" in messages
    assert b"stranger 999" in messages
    assert len(messages) <= 65
    assert inbox.counter.received == 1001


def test_waiting_ends_with_an_arrival_from_another_thread():
    inbox = Inbox()
    thread = threading.Timer(0.02, inbox.put, [message(1)])
    thread.start()
    # Far above the delay: only a lost wake-up takes that long.
    assert inbox.wait(timeout_ns=60_000_000_000)
    thread.join()
    assert taken(inbox) == [b"1/1"]


def test_waiting_ends_without_an_arrival_after_its_time():
    started = time.monotonic_ns()
    assert not Inbox().wait(timeout_ns=20_000_000)
    assert time.monotonic_ns() - started >= 20_000_000


def test_a_taken_message_does_not_wake_the_next_wait():
    inbox = Inbox()
    inbox.put(message(1))
    inbox.take()
    assert not inbox.wait(timeout_ns=1_000_000)


def test_refusals_add_up_over_their_reasons():
    refused = RefusalCounter()
    refused["layout"] += 2
    refused["stale"] += 1
    assert refused.total_refused == 3


def test_answers_are_counted_by_their_sender_and_a_crowd_of_senders_is_bounded():
    counter = SenderCounter()
    for session in range(1000):
        counter.count(Envelope(session, 0, 0, 0), taken=session % 2 == 0)
    counter.count(None, taken=False)
    counter.count(Envelope(0, 1, 0, 0), taken=True)
    by_sender = counter.by_sender
    assert by_sender["00000000"] == {"taken": 2, "refused": 0}
    assert by_sender["00000001"] == {"taken": 0, "refused": 1}
    assert by_sender["others"] == {"taken": 470, "refused": 471}
    assert len(by_sender) == 61
