"""Damaged messages, and the judge of what a decoder makes of them."""

from __future__ import annotations

import numpy as np
import pytest

from shared.errors import MessageRefused

# The names of docs/wire.md that a codec can give; `session`, `stale`, `future` are the nodes'.
REASONS = {
    "oversized",
    "undecodable",
    "version",
    "kind",
    "config",
    "plan",
    "mode",
    "dtype",
    "layout",
    "shape",
    "not_finite",
}

# Quiet and signalling, either sign; a signalling NaN is what a flipped bit makes of an infinity.
NOT_FINITE = {
    "nan": 0x7FF8_0000_0000_0000,
    "negative nan": 0xFFF8_0000_0000_0000,
    "signalling nan": 0x7FF0_0000_0000_0001,
    "infinity": 0x7FF0_0000_0000_0000,
    "negative infinity": 0xFFF0_0000_0000_0000,
}


# The same in single precision.
NOT_FINITE_SINGLE = {
    "nan": 0x7FC0_0000,
    "negative nan": 0xFFC0_0000,
    "signalling nan": 0x7F80_0001,
    "infinity": 0x7F80_0000,
    "negative infinity": 0xFF80_0000,
}


def reason_of(decode, data):
    with pytest.raises(MessageRefused) as refusal:
        decode(data)
    assert refusal.value.reason in REASONS
    return refusal.value.reason


def outcome(decode, data):
    """The message, or the reason why it is refused; any other exception passes through."""
    try:
        return decode(data)
    except MessageRefused as refusal:
        assert refusal.reason in REASONS  # noqa: PT017  (both outcomes are allowed here)
        return refusal.reason


def flip(data: bytes, bit: int) -> bytes:
    damaged = bytearray(data)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def poison(fields, name, position, bits, *, words="<u8"):
    """One number of an array replaced by a bit pattern of its size."""
    numbers = np.frombuffer(fields[name], dtype=words).copy()
    numbers[position] = bits
    fields[name] = numbers.tobytes()
