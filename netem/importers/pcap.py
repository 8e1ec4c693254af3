"""The IP packets of a capture.

Links: Ethernet (with VLAN tags), raw IP, PPP, BSD loopback, Linux cooked. A packet inside
GTP-U (UDP port 2152, as between base station and core) counts in place of the outer one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

from netem.importers.capture_files import frames
from netem.importers.source import wrong

_IPV4, _IPV6, _VLANS = 0x0800, 0x86DD, (0x8100, 0x88A8, 0x9100)
_TCP, _UDP, _SCTP, _GTP_PORT = 6, 17, 132, 2152
_WITH_PORTS = (_TCP, _UDP, _SCTP)
_FRAGMENT_HEADER = 44
# No payload is longer.
WHOLE = 1 << 18
_CHECKSUM = {_UDP: slice(6, 8), _TCP: slice(16, 18)}


class Packet(NamedTuple):
    """An IP packet or fragment. `key` is the same at both ends, `datagram` in all its fragments.

    `flow` is (source, destination). `ports` are those of TCP, UDP and SCTP, as bytes; empty for
    other protocols and for all fragments but the first. `payload_bytes` is the length of IP's
    payload. The capture holds `held_bytes` of it. `last` tells that no fragment follows.
    """

    time_ns: int
    flow: tuple[bytes, bytes]
    key: bytes
    datagram: bytes
    protocol: int
    ports: bytes
    payload_bytes: int
    held_bytes: int
    last: bool


def packets(path: Path, *, compared: int = WHOLE) -> Iterator[Packet]:
    """The IP packets in a capture. `ProfileError` names the record that is wrong.

    The `key` is made of all constant fields and the first `compared` bytes of the payload.
    """
    for frame in frames(path):
        network = _LINKS.get(frame.link)
        if network is None:
            known = ", ".join(str(number) for number in _LINKS)
            raise wrong(path, frame.where, f"a link type of {known}", frame.link)
        packet = _ip(network(frame.data), frame.time_ns, compared)
        if packet is not None:
            yield packet


def held_of_each(path: Path) -> int:
    """The bytes that a capture holds of every payload; `WHOLE` if it cuts no payload short."""
    cut = (p.held_bytes for p in packets(path, compared=0) if p.held_bytes < p.payload_bytes)
    return min(cut, default=WHOLE)


def _ethernet(frame: bytes) -> bytes:
    return _after_type(frame, 12)


def _after_type(frame: bytes, at: int) -> bytes:
    """The payload of an EtherType at `at`, with VLAN tags skipped; empty if it is not IP."""
    kind = int.from_bytes(frame[at : at + 2], "big")
    while kind in _VLANS and len(frame) > at + 6:
        at += 4
        kind = int.from_bytes(frame[at : at + 2], "big")
    return frame[at + 2 :] if kind in (_IPV4, _IPV6) else b""


def _ppp(frame: bytes) -> bytes:
    body = frame.removeprefix(b"\xff\x03")
    return body[2:] if body[:2] in (b"\x00\x21", b"\x00\x57") else b""


_LINKS: dict[int, Callable[[bytes], bytes]] = {
    0: lambda frame: frame[4:],  # BSD loopback: an address family first
    1: _ethernet,
    9: _ppp,
    12: lambda frame: frame,  # raw IP goes under several numbers
    14: lambda frame: frame,
    101: lambda frame: frame,
    113: lambda frame: _after_type(frame, 14),  # Linux cooked
    228: lambda frame: frame,
    229: lambda frame: frame,
    276: lambda frame: frame[20:] if _after_type(frame, 0) else b"",  # Linux cooked, version 2
}


def _ip(data: bytes, time_ns: int, compared: int, *, inside: bool = False) -> Packet | None:
    """The packet in `data`, or the packet inside its GTP-U; None if `data` is not IP."""
    version = data[0] >> 4 if data else 0
    if version == 4 and len(data) >= 20:
        length = (data[0] & 15) * 4
        identity, fragment = data[4:6], int.from_bytes(data[6:8], "big")
        protocol, flow = data[9], (data[12:16], data[16:20])
        body, total = data[length:], int.from_bytes(data[2:4], "big") - length
        offset, more = (fragment & 0x1FFF) * 8, bool(fragment & 0x2000)
    elif version == 6 and len(data) >= 40:
        protocol, flow = data[6], (data[8:24], data[24:40])
        body, total = data[40:], int.from_bytes(data[4:6], "big")
        identity, offset, more = b"", 0, False
        if protocol == _FRAGMENT_HEADER and len(body) >= 8:
            protocol, fragment, identity = body[0], int.from_bytes(body[2:4], "big"), body[4:8]
            offset, more = fragment & 0xFFF8, bool(fragment & 1)
            body, total = body[8:], total - 8
    else:
        return None
    whole_datagram = offset == 0 and not more
    if not inside and protocol == _UDP and whole_datagram and _is_gtp(body):
        return _ip(_inside_gtp(body[8:]), time_ns, compared, inside=True)
    held = min(len(body), max(total, 0))
    start = bytearray(body[: min(held, compared)])
    if offset == 0 and protocol in _CHECKSUM:
        # A sender's network card fills in the checksum after the capture.
        part = _CHECKSUM[protocol]
        start[part] = bytes(len(start[part]))
    datagram = b"".join((*flow, bytes([protocol]), identity))
    seen = blake2b(start, digest_size=12).digest()
    key = datagram + struct.pack(">HI", offset, max(total, 0)) + seen
    ports = bytes(body[:4]) if offset == 0 and protocol in _WITH_PORTS else b""
    return Packet(time_ns, flow, key, datagram, protocol, ports, max(total, 0), held, not more)


def _is_gtp(udp: bytes) -> bool:
    """Return whether a UDP datagram carries a user's packet: GTP version 1, message 255."""
    ports = struct.unpack(">2H", udp[:4]) if len(udp) >= 16 else ()
    return _GTP_PORT in ports and udp[8] & 0xF0 == 0x30 and udp[9] == 0xFF


def _inside_gtp(gtp: bytes) -> bytes:
    """The bytes after GTP's header, its optional fields and its chain of extensions."""
    at = 8
    if gtp[0] & 0x07:
        at, following = 12, gtp[11] if len(gtp) > 11 and gtp[0] & 0x04 else 0
        while following and at < len(gtp) and gtp[at]:
            at += 4 * gtp[at]
            following = gtp[at - 1] if at <= len(gtp) else 0
    return gtp[at:]
