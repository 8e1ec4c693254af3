"""Messages that differ only in some numbers, written as one `struct` each, and still valid msgpack.

An integer in a slot takes nine bytes at any value. Between its slots every message of a form
therefore has the same bytes at the same places. To write or read one is a single call. msgpack's
own encoder writes shorter integers. msgpack's own decoder reads the messages of a form.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgpack


@dataclass(frozen=True)
class Slot:
    """A variable field of a form: the bytes in front of it, from which msgpack tells its type, and
    its code in a `struct`.
    """

    prefix: bytes
    code: str


INTEGER = Slot(b"\xd3", "q")
# From 0 to 127; a number that is read may be larger and is then invalid.
SMALL = Slot(b"", "B")


def binary(size: int) -> Slot:
    """A slot of `size` raw bytes."""
    encoded = msgpack.packb(bytes(size))
    return Slot(encoded[: len(encoded) - size], f"{size}s")


class Form:
    """All messages that are `template` with values in its slots, in the order of the slots."""

    def __init__(self, template: dict[str, Any]) -> None:
        constants: list[bytes] = [b""]
        codes: list[str] = []
        for part in _parts(template):
            if isinstance(part, Slot):
                constants[-1] += part.prefix
                codes.append(part.code)
                constants.append(b"")
            else:
                constants[-1] += part
        lengths = [f"{len(constant)}s" for constant in constants]
        between = [length + code for length, code in zip(lengths, [*codes, ""], strict=True)]
        self._struct = struct.Struct(">" + "".join(between))
        self._constants = tuple(constants)
        self._blank: list[Any] = [None] * (2 * len(codes) + 1)
        self._blank[::2] = constants
        self.size = self._struct.size

    def write(self, *values: int | bytes) -> bytes:
        """The message with these values."""
        parts = self._blank.copy()
        parts[1::2] = values
        return self._struct.pack(*parts)

    def read(self, data: bytes) -> tuple[Any, ...] | None:
        """Return the values in a message of `size` bytes, or None if it is not of this form."""
        parts = self._struct.unpack(data)
        return parts[1::2] if parts[::2] == self._constants else None


def _parts(value: Any) -> Iterator[bytes | Slot]:
    """The encoding of a template, with placeholders at its slots."""
    if isinstance(value, Slot):
        yield value
    elif isinstance(value, dict):
        yield msgpack.Packer().pack_map_header(len(value))
        for key, each in value.items():
            yield msgpack.packb(key)
            yield from _parts(each)
    elif isinstance(value, list):
        yield msgpack.Packer().pack_array_header(len(value))
        for each in value:
            yield from _parts(each)
    else:
        yield msgpack.packb(value)
