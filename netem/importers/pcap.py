"""The IP packets of a capture: classic pcap of either byte order, in µs or ns.

    magic 4, version 2+2, zone 4, accuracy 4, longest 4, link type 4; then per packet
    seconds 4, µs or ns 4, captured length 4, length 4, captured bytes

Links: Ethernet (with VLAN tags), raw IP, PPP, BSD loopback, Linux cooked. IP in GTP-U (UDP port
2152, as between base station and core) is taken out of it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from netem.importers.source import MAX_RECORDS, opened, wrong
from shared.errors import ProfileError

# Byte order, and how many ns the fraction of a second counts.
_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_LONGEST = 1 << 18
_IPV4, _IPV6, _VLANS = 0x0800, 0x86DD, (0x8100, 0x88A8, 0x9100)
_TCP, _UDP, _GTP_PORT = 6, 17, 2152
_FRAGMENT_HEADER = 44
# Of the payload this much tells packets of one number apart; captures may be cut short after it.
_PAYLOAD_BYTES = 20
_CHECKSUM = {_UDP: slice(6, 8), _TCP: slice(16, 18)}


class Packet(NamedTuple):
    """An IP packet or fragment: `key` is the same at both ends, `datagram` in all its fragments.

    `flow` is (source, destination). `payload_bytes` of IP; `last` if no fragment follows.
    """

    time_ns: int
    flow: tuple[bytes, bytes]
    key: bytes
    datagram: bytes
    protocol: int
    payload_bytes: int
    last: bool


def is_pcap(start: bytes) -> bool:
    """Whether a file that begins so is a capture, classic or pcapng."""
    return start[:4] in _MAGICS or start[:4] == _PCAPNG


def packets(path: Path) -> Iterator[Packet]:
    """The IP packets in a capture; `ProfileError` with the record that is wrong."""
    with opened(path) as file:
        header = file.read(24)
        if header[:4] == _PCAPNG:
            raise ProfileError(
                f"{path}: pcapng; expected classic pcap: editcap -F pcap {path.name} OUT.pcap"
            )
        if header[:4] not in _MAGICS or len(header) < 24:
            raise wrong(path, "byte 0", "the header of a pcap file", header[:4])
        order, unit_ns = _MAGICS[header[:4]]
        link = struct.unpack(order + "I", header[20:])[0] & 0x0FFFFFFF
        network = _LINKS.get(link)
        if network is None:
            known = ", ".join(str(number) for number in _LINKS)
            raise wrong(path, "byte 20", f"a link type of {known}", link)
        at = 24
        for record in range(1, MAX_RECORDS + 1):
            head = file.read(16)
            if not head:
                return
            where = f"record {record} at byte {at}"
            if len(head) < 16:
                raise wrong(path, where, "16 bytes of a record's header", f"{len(head)} bytes")
            seconds, fraction, captured, _ = struct.unpack(order + "4I", head)
            if captured > _LONGEST or fraction * unit_ns >= 1_000_000_000:
                raise wrong(
                    path,
                    where,
                    f"a fraction below a second and at most {_LONGEST} bytes",
                    f"{fraction} and {captured}",
                )
            data = file.read(captured)
            if len(data) < captured:
                raise wrong(path, where, f"{captured} bytes", f"{len(data)} bytes")
            at += 16 + captured
            packet = _ip(network(data), seconds * 1_000_000_000 + fraction * unit_ns)
            if packet is not None:
                yield packet
        raise ProfileError(f"{path}: expected at most {MAX_RECORDS} packets")


def _ethernet(frame: bytes) -> bytes:
    return _after_type(frame, 12)


def _after_type(frame: bytes, at: int) -> bytes:
    """What follows an EtherType at `at`, VLAN tags skipped; empty if it is not IP."""
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


def _ip(data: bytes, time_ns: int, *, inside: bool = False) -> Packet | None:
    """The packet that `data` is, or the one inside if it is GTP-U; None if it is not IP."""
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
        return _ip(_inside_gtp(body[8:]), time_ns, inside=True)
    start = bytearray(body[: min(_PAYLOAD_BYTES, max(total, 0))])
    if offset == 0 and protocol in _CHECKSUM:
        # A sender's network card fills it in after the capture.
        part = _CHECKSUM[protocol]
        start[part] = bytes(len(start[part]))
    datagram = b"".join((*flow, bytes([protocol]), identity))
    key = datagram + struct.pack(">HI", offset, zlib.crc32(start))
    return Packet(time_ns, flow, key, datagram, protocol, max(total, 0), not more)


def _is_gtp(udp: bytes) -> bool:
    """Whether a UDP datagram carries a user's packet: GTP version 1, message 255."""
    ports = struct.unpack(">2H", udp[:4]) if len(udp) >= 16 else ()
    return _GTP_PORT in ports and udp[8] & 0xF0 == 0x30 and udp[9] == 0xFF


def _inside_gtp(gtp: bytes) -> bytes:
    """What follows GTP's header, its optional fields and its chain of extensions."""
    at = 8
    if gtp[0] & 0x07:
        at, following = 12, gtp[11] if len(gtp) > 11 and gtp[0] & 0x04 else 0
        while following and at < len(gtp) and gtp[at]:
            at += 4 * gtp[at]
            following = gtp[at - 1] if at <= len(gtp) else 0
    return gtp[at:]
