from __future__ import annotations

import pytest

from shared.bus.endpoint import parse_endpoint
from shared.errors import LinkError


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("tcp/127.0.0.1:7460", "127.0.0.1", 7460),
        ("udp/edge.example.org:1", "edge.example.org", 1),
        ("tcp/[2001:db8::7]:7460", "2001:db8::7", 7460),
        ("tcp/0.0.0.0:7460#so_sndbuf=262144", "0.0.0.0", 7460),
        ("unixsock-stream//tmp/edge.sock", "/tmp/edge.sock", 0),
    ],
)
def test_an_endpoint_has_its_parts_and_is_written_as_it_was_read(text, host, port):
    endpoint = parse_endpoint(text, secured=False)
    assert (endpoint.host, endpoint.port) == (host, port)
    assert str(endpoint) == text


@pytest.mark.parametrize(
    "text",
    ["", "7460", "127.0.0.1:7460", "tcp/127.0.0.1", "tcp/:7460", "tcp/h:0", "tcp/h:65536",
     "tcp/h:port", "http/h:80", "tcp/2001:db8::7:7460", "tcp/h:1 "],
)  # fmt: skip
def test_what_is_no_endpoint_is_refused_with_an_example(text):
    with pytest.raises(LinkError, match=r"expected PROTOCOL/HOST:PORT as in tcp/127\.0\.0\.1:7460"):
        parse_endpoint(text, secured=False)


def test_certificates_and_plain_endpoints_do_not_go_together():
    with pytest.raises(LinkError, match="expected tls or quic with --secure, got 'tcp/h:1'"):
        parse_endpoint("tcp/h:1", secured=True)
    with pytest.raises(LinkError, match="add --secure"):
        parse_endpoint("tls/h:1", secured=False)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("127.1.2.3", True), ("localhost", True), ("[::1]", True),
     ("0.0.0.0", False), ("[::]", False), ("192.0.2.7", False), ("127.0.0.1.example", False)],
)  # fmt: skip
def test_only_this_machines_own_addresses_are_loopback(host, expected):
    assert parse_endpoint(f"tcp/{host}:1", secured=False).on_loopback is expected


def test_what_listens_on_every_address_is_dialled_on_loopback_from_here():
    for every in ("0.0.0.0", "[::]"):
        endpoint = parse_endpoint(f"tls/{every}:7447", secured=True)
        assert str(endpoint.dialled_here) == "tls/127.0.0.1:7447"
    assert str(parse_endpoint("tls/h:1", secured=True).dialled_here) == "tls/h:1"
