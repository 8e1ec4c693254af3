"""The packet pump over pairs of sockets, which keep packets apart as a TUN device does."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from netem.delay_line import make_lines
from netem.networks import load_network
from netem.packet_pump import Lateness, Way, pump, wait_for_packet
from netem.profile import DOWNLINK, UPLINK
from shared.config.link_settings import LinkConfig
from shared.errors import LinkError
from tests.processes import PATIENCE_SECONDS, until

MS = 1_000_000
ROOM = 1 << 20


class Ends:
    """Two ends of a link: what is sent at one is received at the other."""

    def __init__(self, network: str, *, queue_bytes: int = ROOM, loss: float = 0.0) -> None:
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
        self.ends = [pair[0] for pair in pairs]
        self._tuns = [pair[1] for pair in pairs]
        for tun in self._tuns:
            tun.setblocking(False)
        for end in self.ends:
            end.settimeout(PATIENCE_SECONDS)
        config = replace(LinkConfig(), loss=loss)
        profile = load_network(network)
        lines = make_lines(profile, config, seed=0, start_ns=time.monotonic_ns())
        robot, edge = (tun.fileno() for tun in self._tuns)
        self.ways = [
            Way(line, source=source, target=target, queue_bytes=queue_bytes, packet_bytes=1500)
            for line, source, target in zip(lines, (robot, edge), (edge, robot), strict=True)
        ]

    @contextmanager
    def pumping(self) -> Iterator[None]:
        done = threading.Event()
        thread = threading.Thread(target=pump, args=(self.ways,), kwargs={"stopping": done.is_set})
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()
            self.close()

    def close(self) -> None:
        for each in (*self.ends, *self._tuns):
            each.close()


@pytest.mark.parametrize(("direction", "delay_ns"), [(UPLINK, 10 * MS), (DOWNLINK, 25 * MS)])
def test_packets_pass_whole_in_order_and_not_before_their_delay(
    direction: int, delay_ns: int
) -> None:
    link = Ends("constant:10ms/25ms")
    sender, receiver = link.ends[direction], link.ends[1 - direction]
    packets = [bytes([k]) * (20 + 11 * k) for k in range(100)]
    sent_ns = []

    def send() -> None:
        for packet in packets:
            sent_ns.append(time.monotonic_ns())
            sender.send(packet)
            time.sleep(0.0005)

    sending = threading.Thread(target=send)
    with link.pumping():
        sending.start()
        for k, packet in enumerate(packets):
            assert receiver.recv(2000) == packet
            assert time.monotonic_ns() - sent_ns[k] >= delay_ns
        sending.join()
    way = link.ways[direction]
    assert (way.packets, way.bytes) == (100, sum(map(len, packets)))
    assert way.lateness.max_ns > 0
    assert link.ways[1 - direction].packets == 0


def test_a_packet_that_finds_no_room_is_dropped_and_those_that_wait_are_kept() -> None:
    link = Ends("constant:200ms/200ms", queue_bytes=3_500)
    # All at once, however long the pump takes.
    for k in range(5):
        link.ends[0].send(bytes([k]) * 1_000)
    with link.pumping():
        arrived = [link.ends[1].recv(2000)[0] for _ in range(3)]
        # There is room again once they have left.
        link.ends[0].send(bytes([9]) * 1_000)
        arrived.append(link.ends[1].recv(2000)[0])
    assert arrived == [0, 1, 2, 9]
    assert link.ways[UPLINK].full == 2


def test_lost_packets_take_no_room() -> None:
    link = Ends("constant:1ms", queue_bytes=3_500, loss=1.0)
    with link.pumping():
        for _ in range(20):
            link.ends[0].send(bytes(1_000))
        until(lambda: link.ways[UPLINK].packets >= 20, lambda: f"{link.ways[UPLINK].packets}")
    assert link.ways[UPLINK].line.lost == 20
    assert link.ways[UPLINK].full == 0


def test_an_end_that_takes_nothing_loses_packets_and_nothing_else() -> None:
    link = Ends("constant:1ms")
    link.ends[1].close()
    with link.pumping():
        link.ends[0].send(b"to nobody")
        until(lambda: link.ways[UPLINK].refused, "nothing was refused")
    assert link.ways[UPLINK].refused == 1


def test_a_burst_one_way_does_not_hold_the_other_back() -> None:
    link = Ends("constant:1ms")
    now_ns = time.monotonic_ns()
    for way, count in zip(link.ways, (100, 1), strict=True):
        for _ in range(count):
            way.line.push(b"x", sent_ns=now_ns - 50 * MS)
    link.ways[UPLINK].release()
    # It is the other's turn before all have left.
    assert 0 < len(link.ways[UPLINK].line) < 100
    link.close()


def test_a_device_that_is_gone_is_said_to_be() -> None:
    link = Ends("constant:1ms")
    with open(os.devnull, "wb") as unreadable:
        link.ways[UPLINK].source = unreadable.fileno()
        with pytest.raises(LinkError, match="expected packets from a TUN device"):
            link.ways[UPLINK].take()
    link.close()


def test_a_link_that_is_stopped_before_its_first_packet_has_no_beginning() -> None:
    link = Ends("constant:1ms")
    sources = [way.source for way in link.ways]
    assert wait_for_packet(sources, stopping=lambda: True) is None
    link.ends[0].send(b"x")
    before_ns = time.monotonic_ns()
    start_ns = wait_for_packet(sources, stopping=lambda: False)
    assert start_ns is not None
    assert start_ns >= before_ns
    link.close()


def test_quantiles_of_lateness_are_those_of_the_samples_to_a_bin() -> None:
    late_ns = np.random.default_rng(0).integers(0, 5 * MS, size=10_000)
    lateness = Lateness()
    for each in late_ns:
        lateness.add(int(each))
    for fraction in (0.5, 0.99):
        # Ten microseconds are a bin.
        expected_ms = np.quantile(late_ns, fraction) * 1e-6
        assert lateness.quantile_ms(fraction) == pytest.approx(expected_ms, abs=0.01)
    assert lateness.max_ns == late_ns.max()
    assert Lateness().quantile_ms(0.5) == 0.0
