"""What arrives on the bus's thread is stamped there and read by the loop in its own time."""

from __future__ import annotations

import time

from netem.recorder.record_loops import Arrival, Arrivals
from shared.bus.base import Delivery, Envelope
from shared.bus.zenoh_bus import machine_clock

SECOND = 1_000_000_000


def envelope(clock):
    return Envelope(session=1, sequence=0, sent_ns=0, clock=clock)


def test_arrivals_are_read_in_order_with_the_time_they_came():
    arrivals = Arrivals(read=3)
    read: list[Arrival] = []
    before_ns = time.monotonic_ns()
    for data in (b"first", b"second"):
        arrivals.put(Delivery(data, None))
    after_ns = time.monotonic_ns()
    arrivals.read_until(after_ns + SECOND, read.append)
    assert [arrival.data for arrival in read] == [b"fir", b"sec"]
    stamps = [arrival.now.monotonic_ns for arrival in read]
    assert before_ns <= stamps[0] <= stamps[1] <= after_ns


def test_a_late_loop_reads_one_message_and_goes_on():
    arrivals = Arrivals(read=None)
    read: list[Arrival] = []
    for data in (b"a", b"b", b"c"):
        arrivals.put(Delivery(data, None))
    arrivals.read_until(time.monotonic_ns(), read.append)
    assert [arrival.data for arrival in read] == [b"a"]


def test_a_sender_on_this_machine_is_known_by_its_clock():
    arrivals = Arrivals(read=None)
    read: list[Arrival] = []
    ours = machine_clock()
    for sender in (envelope(ours), envelope(ours + 1), None):
        arrivals.put(Delivery(b"", sender))
    arrivals.read_until(time.monotonic_ns() + SECOND, read.append)
    assert [arrival.one_clock for arrival in read] == [ours != 0, False, False]


def test_what_nobody_reads_is_bounded_and_counted():
    arrivals = Arrivals(read=None)
    for _ in range(10_000):
        arrivals.put(Delivery(b"", None))
    assert arrivals.missed == 10_000 - 8192
