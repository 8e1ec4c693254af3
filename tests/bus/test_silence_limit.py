"""The limit on the silence of connections: which sockets of a process get it, and until when."""

from __future__ import annotations

import contextlib
import socket

import pytest

from shared.bus.silence_limit import SilenceLimit, limit_silence
from tests.processes import until

pytestmark = pytest.mark.skipif(
    not hasattr(socket, "TCP_USER_TIMEOUT"), reason="only Linux has the option"
)


@pytest.fixture
def ends():
    """A listener, the two ends of a connection to it, and a socket of another port."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        dialled = stack.enter_context(socket.create_connection(listener.getsockname()))
        accepted = stack.enter_context(listener.accept()[0])
        other = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        yield listener, dialled, accepted, other


def limit_of(each: socket.socket) -> int:
    return each.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


def test_listener_and_both_ends_of_a_connection_get_the_limit_and_no_other_socket(ends):
    listener, dialled, accepted, other = ends
    assert limit_silence([listener.getsockname()[1]], seconds=1.5) == 3
    assert [limit_of(each) for each in (listener, dialled, accepted)] == [1500] * 3
    assert limit_of(other) == 0


def test_a_later_connection_gets_it_too(ends):
    listener, *_ = ends
    port = listener.getsockname()[1]
    with (
        contextlib.closing(SilenceLimit([port], seconds=1.0)),
        socket.create_connection(("127.0.0.1", port)) as later,
    ):
        until(lambda: limit_of(later) == 1000, lambda: "no limit")
