"""The frames of a capture: classic pcap of either byte order, in µs or ns, and pcapng.

pcap      magic 4, version 2+2, zone 4, accuracy 4, longest 4, link type 4; then per frame
          seconds 4, µs or ns 4, captured length 4, length 4, captured bytes
pcapng    blocks of type 4, length 4, …, length 4: sections (byte order), interfaces (link type
          2, 2, snap length 4, options), frames (interface 4, time 4+4, captured 4, length 4, …)
"""

from __future__ import annotations

import gzip
import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from netem.importers.source import MAX_RECORDS, opened, wrong
from shared.errors import ProfileError

_S = 1_000_000_000
# Byte order, and the unit of the fraction of a second [ns].
_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
_SECTION, _INTERFACE, _OLD_FRAME, _SIMPLE_FRAME, _FRAME = 0x0A0D0D0A, 1, 2, 3, 6
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_RESOLUTION, _OFFSET = 9, 14
_LONGEST = 1 << 18
_LONGEST_BLOCK = 1 << 24
_File = io.BufferedReader | gzip.GzipFile


class Frame(NamedTuple):
    """A frame as it was captured. `where` is its place in the file."""

    time_ns: int
    link: int
    data: bytes
    where: str


class _Interface(NamedTuple):
    """An interface of a capture: its link type, units of time to a second, and seconds to add."""

    link: int
    per_second: int
    offset_s: int


def is_capture(start: bytes) -> bool:
    """Return whether a file with this beginning is a capture, classic or pcapng."""
    return start[:4] in _MAGICS or start[:4] == _SECTION.to_bytes(4, "big")


def frames(path: Path) -> Iterator[Frame]:
    """The frames of a capture. `ProfileError` names the record or block that is wrong."""
    with opened(path) as file:
        magic = file.read(4)
        if magic == _SECTION.to_bytes(4, "big"):
            read = _pcapng(path, file)
        elif magic in _MAGICS:
            read = _pcap(path, file, *_MAGICS[magic])
        else:
            raise wrong(path, "byte 0", "the header of a pcap file", magic)
        for count, frame in enumerate(read):
            if count >= MAX_RECORDS:
                raise ProfileError(
                    f"{path}: expected at most {MAX_RECORDS} packets, got more; cut it, as by "
                    "editcap -i 60"
                )
            yield frame


def _pcap(path: Path, file: _File, order: str, unit_ns: int) -> Iterator[Frame]:
    header = file.read(20)
    if len(header) < 20:
        raise wrong(path, "byte 4", "the header of a pcap file", f"{len(header)} bytes")
    link = struct.unpack(order + "I", header[16:])[0] & 0x0FFFFFFF
    at, record = 24, 1
    while head := file.read(16):
        where = f"record {record} at byte {at}"
        if len(head) < 16:
            raise _cut_short(path, where, "16 bytes of a record's header", len(head))
        seconds, fraction, captured, _ = struct.unpack(order + "4I", head)
        if captured > _LONGEST or fraction * unit_ns >= _S:
            raise wrong(
                path,
                where,
                f"a fraction below a second and at most {_LONGEST} bytes",
                f"{fraction} and {captured}",
            )
        data = file.read(captured)
        if len(data) < captured:
            raise _cut_short(path, where, f"{captured} bytes", len(data))
        yield Frame(seconds * _S + fraction * unit_ns, link, data, where)
        at, record = at + 16 + captured, record + 1


def _cut_short(path: Path, where: str, expected: str, got: int) -> ProfileError:
    error = wrong(path, where, expected, f"{got} bytes")
    return ProfileError(
        f"{error}: the capture was stopped in it; try editcap IN OUT, which drops it"
    )


def _pcapng(path: Path, file: _File) -> Iterator[Frame]:
    interfaces: list[_Interface] = []
    order, at, block = "<", 0, 1
    kind = _SECTION.to_bytes(4, "big")
    while kind:
        where = f"block {block} at byte {at}"
        length, body = _block(path, file, where, kind, order)
        if kind == _SECTION.to_bytes(4, "big"):
            order, interfaces = _ORDERS[body[:4]], []
        number = int.from_bytes(kind, "little" if order == "<" else "big")
        if number == _INTERFACE:
            interfaces.append(_interface(path, where, body, order))
        elif number in (_FRAME, _OLD_FRAME):
            yield _frame(path, where, body, order, number, interfaces)
        elif number == _SIMPLE_FRAME:
            raise wrong(path, where, "frames with times", "a simple packet block, which has none")
        at, block, kind = at + length, block + 1, file.read(4)


def _block(path: Path, file: _File, where: str, kind: bytes, order: str) -> tuple[int, bytes]:
    """The length [bytes] and the content of a block."""
    head = file.read(4)
    if kind == _SECTION.to_bytes(4, "big"):
        magic = file.read(4)
        if magic not in _ORDERS:
            raise wrong(path, where, "the byte order of a section", magic)
        order = _ORDERS[magic]
    else:
        magic = b""
    if len(kind) < 4 or len(head) < 4:
        raise wrong(path, where, "8 bytes of a block's header", f"{len(kind + head)} bytes")
    (length,) = struct.unpack(order + "I", head)
    if not 12 + len(magic) <= length <= _LONGEST_BLOCK or length % 4:
        raise wrong(path, where, f"a length of whole words, at most {_LONGEST_BLOCK}", length)
    rest = file.read(length - 8 - len(magic))
    if len(rest) < length - 8 - len(magic) or rest[-4:] != head:
        raise wrong(path, where, f"{length} bytes and the same length behind them", "others")
    return length, magic + rest[:-4]


def _interface(path: Path, where: str, body: bytes, order: str) -> _Interface:
    if len(body) < 8:
        raise wrong(path, where, "an interface", f"{len(body)} bytes")
    link, _, _ = struct.unpack(order + "HHI", body[:8])
    per_second, offset_s, at = 1_000_000, 0, 8
    while at + 4 <= len(body):
        code, size = struct.unpack(order + "HH", body[at : at + 4])
        value = body[at + 4 : at + 4 + size]
        if code == _RESOLUTION and size == 1:
            per_second = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** (value[0] & 0x7F)
        elif code == _OFFSET and len(value) == 8:
            (offset_s,) = struct.unpack(order + "q", value)
        at += 4 + size + -size % 4
    return _Interface(link, per_second, offset_s)


def _frame(
    path: Path, where: str, body: bytes, order: str, number: int, interfaces: list[_Interface]
) -> Frame:
    if len(body) < 20:
        raise wrong(path, where, "a frame", f"{len(body)} bytes")
    index = struct.unpack(order + ("I" if number == _FRAME else "Hxx"), body[:4])[0]
    high, low, captured, _ = struct.unpack(order + "4I", body[4:20])
    if index >= len(interfaces) or captured > min(len(body) - 20, _LONGEST):
        raise wrong(
            path,
            where,
            f"one of {len(interfaces)} interfaces and at most {len(body) - 20} bytes",
            f"{index} and {captured}",
        )
    interface = interfaces[index]
    time_ns = (high << 32 | low) * _S // interface.per_second + interface.offset_s * _S
    if abs(time_ns) >= 2**62:
        raise wrong(path, where, "a time within 146 years", time_ns)
    return Frame(time_ns, interface.link, body[20 : 20 + captured], where)
