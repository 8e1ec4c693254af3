"""What a person reads when nobody answers; handshakes are tested in tests/live/test_security.py."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.keys import make
from shared.bus.preflight import preflight
from shared.bus.security import Credentials
from shared.bus.zenoh_bus import ZenohBus
from shared.errors import LinkError


@pytest.fixture
def listening() -> Iterator[int]:
    """The port of somebody who accepts connections and says nothing."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield server.getsockname()[1]


@pytest.fixture
def closed_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def credentials(tmp_path: Path) -> Credentials:
    make(tmp_path, robots=["romeo"])
    return Credentials.load(tmp_path, "robot-romeo", robots=("romeo",))


def test_a_closed_port_says_to_start_the_edge(closed_port: int):
    message = preflight(f"tcp/127.0.0.1:{closed_port}", None)
    assert message.startswith(f"tcp/127.0.0.1:{closed_port} refuses connections; start the edge")


def test_an_unknown_name_is_said_to_be_unknown():
    assert "does not know nobody.invalid" in preflight("tcp/nobody.invalid:7460", None)


def test_an_open_port_asks_for_the_same_settings(listening: int):
    assert "same --name, task, robot, wbc and walk" in preflight(f"tcp/127.0.0.1:{listening}", None)


def test_an_endpoint_that_cannot_be_knocked_at_asks_for_its_udp_port():
    assert "UDP port 7460" in preflight("udp/127.0.0.1:7460", None)


def test_a_port_without_tls_is_called_plain_and_not_given_up(
    listening: int, credentials: Credentials
):
    assert "plain endpoint" in preflight(f"tls/127.0.0.1:{listening}", credentials)


def test_dialling_gives_up_in_time_and_says_what_it_found(closed_port: int):
    began = time.monotonic()
    with pytest.raises(LinkError, match=r"no connection within 0\.5 s: .* refuses connections"):
        ZenohBus.dial(f"tcp/127.0.0.1:{closed_port}", within=0.5)
    assert time.monotonic() - began < 5.0


def test_dialling_ends_when_it_is_told_to(closed_port: int):
    stopped = threading.Event()
    threading.Timer(0.3, stopped.set).start()
    with pytest.raises(KeyboardInterrupt):
        ZenohBus.dial(f"tcp/127.0.0.1:{closed_port}", within=60.0, stopping=stopped.is_set)
