from __future__ import annotations

import pytest

from shared.bus.base import Delivery, Envelope
from shared.bus.memory import MemoryBus
from shared.clock import SimClock


@pytest.fixture
def clock():
    return SimClock(5_000)


@pytest.fixture
def bus(clock):
    return MemoryBus(clock)


def test_a_message_is_there_when_publishing_returns(bus):
    received: list[Delivery] = []
    bus.subscribe("key", received.append)
    bus.publisher("key").publish(b"hello")
    assert [delivery.data for delivery in received] == [b"hello"]


def test_every_subscriber_of_a_key_receives_and_no_other(bus):
    here: list[Delivery] = []
    there: list[Delivery] = []
    elsewhere: list[Delivery] = []
    bus.subscribe("key", here.append)
    bus.subscribe("key", there.append)
    bus.subscribe("other", elsewhere.append)
    bus.publisher("key").publish(b"x")
    assert len(here) == len(there) == 1
    assert elsewhere == []


def test_a_publisher_made_before_its_subscriber_reaches_it(bus):
    received: list[Delivery] = []
    publisher = bus.publisher("key")
    publisher.publish(b"nobody listens")
    bus.subscribe("key", received.append)
    publisher.publish(b"x")
    assert [delivery.data for delivery in received] == [b"x"]
    assert publisher.sent == 2


def test_envelopes_tell_publisher_number_and_time(bus, clock):
    received: list[Delivery] = []
    bus.subscribe("key", received.append)
    first, second = bus.publisher("key"), bus.publisher("key")
    first.publish(b"a")
    clock.time_ns = 6_000
    first.publish(b"b")
    second.publish(b"c")
    a, b, c = (delivery.envelope for delivery in received)
    assert (a.sequence, b.sequence, c.sequence) == (0, 1, 0)
    assert (a.sent_ns, b.sent_ns, c.sent_ns) == (5_000, 6_000, 6_000)
    assert a.session == b.session != c.session


def test_forwarding_keeps_the_envelope_of_the_sender(bus):
    received: list[Delivery] = []
    bus.subscribe("key", received.append)
    publisher = bus.publisher("key")
    delivery = Delivery(b"x", Envelope(77, 9, 123, 4))
    publisher.forward(delivery)
    assert received == [delivery]
    assert publisher.sent == 1


def test_a_closed_bus_delivers_nothing_to_new_publishers(bus):
    received: list[Delivery] = []
    bus.subscribe("key", received.append)
    bus.close()
    bus.publisher("key").publish(b"x")
    assert received == []
