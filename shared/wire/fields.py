"""Checked fields of a message: each of the right type, shape and size, or refused by its name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from shared.errors import MessageRefused
from shared.wbc.contacts import ContactMode
from shared.wbc.finite import all_finite

MAX_INT = 2**63 - 1
SINGLE = np.dtype("<f4")
DOUBLE = np.dtype("<f8")


def integer_of(fields: dict[str, Any], name: str) -> int:
    """Return an integer field; raise `MessageRefused` if it is none."""
    value = fields.get(name)
    if type(value) is not int or not -MAX_INT <= value <= MAX_INT:
        raise MessageRefused("shape", name)
    return value


def array_of(
    fields: dict[str, Any],
    name: str,
    shape: tuple[int, ...],
    *,
    dtype: np.dtype[Any] = DOUBLE,
) -> np.ndarray:
    """Return an array of a shape, in double precision; raise `MessageRefused` if it is none."""
    data = fields.get(name)
    if not isinstance(data, bytes) or len(data) != dtype.itemsize * math.prod(shape):
        raise MessageRefused("shape", name)
    numbers = np.frombuffer(data, dtype=dtype)
    if not all_finite(numbers):
        raise MessageRefused("not_finite", name)
    return numbers.astype(np.float64, copy=False).reshape(shape)


def mode_of(fields: dict[str, Any]) -> ContactMode:
    """Return the contact mode; raise `MessageRefused` if it is none."""
    try:
        return ContactMode(integer_of(fields, "mode"))
    except ValueError:
        raise MessageRefused("mode", repr(fields.get("mode"))) from None


def held_sequences_of(fields: dict[str, Any]) -> tuple[int, ...] | None:
    """Return the factorisations that a robot holds, by mode; None if it lists none."""
    held_sequences = fields.get("holds")
    if held_sequences is None:
        return None
    if not isinstance(held_sequences, list) or len(held_sequences) != len(ContactMode):
        raise MessageRefused("shape", "holds")
    if any(type(each) is not int or not -1 <= each <= MAX_INT for each in held_sequences):
        raise MessageRefused("shape", "holds")
    return tuple(held_sequences)


def finite_numbers(data: bytes, dtype: np.dtype[Any] = DOUBLE) -> np.ndarray | None:
    """Return the numbers as float64, or None if one of them is not finite."""
    numbers = np.frombuffer(data, dtype)
    if not all_finite(numbers):
        return None
    return numbers if dtype is DOUBLE else numbers.astype(np.float64)
