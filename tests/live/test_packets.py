"""The packet-level link between real namespaces: what passes, after how long, what is left."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from benchmarks.real_path.namespaces import Machine
from netem.tun import EDGE_ADDRESS, ROBOT_ADDRESS, NamespacePair, namespaces
from shared.errors import LinkError
from shared.process.entry import python
from tests.processes import Process, played

pytestmark = pytest.mark.live

Start = Callable[..., Process]
# Names of this process's own: another run may be using the usual ones.
ROBOT = Machine(f"wbc-test-robot-{os.getpid()}", ROBOT_ADDRESS)
EDGE = Machine(f"wbc-test-edge-{os.getpid()}", EDGE_ADDRESS)
NAMES = ("--robot-ns", ROBOT.namespace, "--edge-ns", EDGE.namespace)

ECHO = """
import socket
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("", 7))
print("READY", flush=True)
while True:
    data, sender = link.recvfrom(65536)
    link.sendto(data, sender)
"""
PING = """
import socket, sys, time
host, size, count, patience = sys.argv[1], *(int(word) for word in sys.argv[2:])
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.settimeout(patience)
for _ in range(count):
    sent = time.monotonic_ns()
    link.sendto(bytes(size), (host, 7))
    try:
        link.recv(65536)
        print(time.monotonic_ns() - sent)
    except TimeoutError:
        print(-1)
"""


@pytest.fixture(scope="module", autouse=True)
def _permitted() -> None:
    try:
        with NamespacePair(robot=ROBOT.namespace, edge=EDGE.namespace, mtu=1500):
            pass
    except LinkError as error:
        pytest.skip(str(error))


@contextmanager
def echo_server() -> Iterator[None]:
    """Sends back every datagram, at the edge's end."""
    command = EDGE.command(*python("-c", ECHO))
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        assert server.stdout.readline() == "READY\n"
        yield
    finally:
        server.kill()
        server.wait()
        server.stdout.close()


def round_trips_ns(*, size: int, count: int, patience: int = 30) -> list[int]:
    """Of datagrams from the robot's end; −1 for one that did not come back in `patience` [s]."""
    words = (EDGE.address, str(size), str(count), str(patience))
    command = ROBOT.command(*python("-c", PING, *words))
    done = played(*command)
    assert done.returncode == 0, done.stderr
    return [int(line) for line in done.stdout.split()]


@pytest.mark.parametrize("mtu", [1500, 65535])
def test_packets_and_fragments_take_the_delays_of_the_profile(start: Start, mtu: int) -> None:
    link = start("netem", "packets", "constant:10ms/30ms", "--mtu", str(mtu), *NAMES)
    link.wait_for("READY")
    with echo_server():
        for size in (100, 40_000):
            trips = round_trips_ns(size=size, count=10)
            assert len(trips) == 10
            assert min(trips) >= 40_000_000
    link.end()
    up, down = (link.wait_for(way) for way in ("uplink:", "downlink:"))
    # A datagram of 40 kB is 28 packets of 1500 bytes with their headers, or one.
    packets = 10 + 10 * (28 if mtu == 1500 else 1)
    assert f"uplink: {packets} packets" in up
    assert f"downlink: {packets} packets" in down
    assert namespaces_of_this_test() == []


def test_a_message_is_lost_with_any_of_its_fragments(start: Start) -> None:
    link = start("netem", "packets", "constant:0ms", "--loss", "0.1", *NAMES)
    link.wait_for("READY")
    with echo_server():
        trips = round_trips_ns(size=40_000, count=4, patience=1)
    # Both ways without any loss: 0.9 to the 56th, 0.003; one of four 0.01. The seed is fixed.
    assert trips == [-1] * 4
    link.end()
    up = re.search(r"uplink: 112 packets.* lost (\d+) by the profile", link.wait_for("uplink:"))
    assert up is not None
    # Far fewer packets than messages: three standard deviations of 112 draws.
    assert 1 <= int(up[1]) <= 21


def test_the_stack_balances_over_packets(start: Start, tmp_path: Path) -> None:
    link = start("netem", "packets", "constant:20ms", *NAMES)
    link.wait_for("READY")
    endpoint = f"tcp/{EDGE.address}:7460"
    controller = ("--controller", "lc", "--push", "none")
    edge = start("edge_node", "--listen", endpoint, *controller, machine=EDGE)
    edge.wait_for("READY")
    robot = start(
        *("robot_node", "--connect", endpoint, *controller),
        *("--duration", "2", "--out", str(tmp_path)),
        machine=ROBOT,
    )
    assert robot.wait() == 0, robot.output
    robot.wait_for("stands after 2.00 s")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_namespaces_and_devices_are_gone_afterwards(start: Start, number: signal.Signals) -> None:
    link = start("netem", "packets", "constant:20ms", *NAMES)
    link.wait_for("READY")
    assert namespaces_of_this_test() == sorted((ROBOT.namespace, EDGE.namespace))
    link.signal(number)
    assert link.wait() == 0, link.output
    assert namespaces_of_this_test() == []


def test_what_a_killed_run_left_is_named_with_its_remedy(start: Start) -> None:
    killed = start("netem", "packets", "constant:20ms", *NAMES)
    killed.wait_for("READY")
    killed.signal(signal.SIGKILL)
    killed.wait()
    try:
        again = start("netem", "packets", "constant:20ms", *NAMES)
        assert again.wait() == 2
        assert len(again.lines) == 1, again.output
        remedy = again.output.partition("remove it with ")[2]
        assert remedy == f"ip netns del {ROBOT.namespace} && ip netns del {EDGE.namespace}"
    finally:
        for name in namespaces_of_this_test():
            subprocess.run(["ip", "netns", "del", name], check=True)


def test_namespaces_in_use_are_left_alone(start: Start) -> None:
    first = start("netem", "packets", "constant:20ms", *NAMES)
    first.wait_for("READY")
    with echo_server():
        second = start("netem", "packets", "constant:20ms", *NAMES)
        assert second.wait() == 2
        assert "in use by process" in second.output
        assert all(trip >= 20_000_000 for trip in round_trips_ns(size=10, count=2))


def namespaces_of_this_test() -> list[str]:
    return sorted(name for name in namespaces() if name in (ROBOT.namespace, EDGE.namespace))
