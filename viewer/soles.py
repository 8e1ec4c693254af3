"""The active set in words: the side of each sole whose contact points are at a limit.

A contact point is *unloaded* if its least normal force is active, and at its *friction* if only
friction rows are. A side of the sole is at a limit if both of its points are.
"""

from __future__ import annotations

import itertools

import numpy as np

from shared.robots import Foot
from shared.telemetry.schema import Schema
from shared.wbc.contacts import POINTS_PER_FOOT, ROWS_PER_FOOT, ROWS_PER_POINT
from viewer.colours import SOLES, Colour

# A side is drawn if it is at its limit in any tick of a span of this length.
SPAN_NS = 20_000_000
_POINTS = ("heel right", "heel left", "toe right", "toe left")  # as `Sole.corners`
_SIDES = {
    frozenset({0, 1, 2, 3}): "whole sole",
    frozenset({2, 3}): "toe",
    frozenset({0, 1}): "heel",
    frozenset({1, 3}): "left side",
    frozenset({0, 2}): "right side",
    frozenset({0, 3}): "across",
    frozenset({1, 2}): "across",
    **{frozenset({k}): name for k, name in enumerate(_POINTS)},
    **{frozenset(range(4)) - {k}: f"all but {name}" for k, name in enumerate(_POINTS)},
}
NO_LIMIT = ""
SOLE_STATES: dict[str, Colour] = {
    f"{side}: {kind}": colour
    for side, (kind, colour) in itertools.product(sorted(set(_SIDES.values())), SOLES.items())
}


def sole_state(mask: int, foot: int) -> str:
    """Return one of `SOLE_STATES` for the foot 0 (left) or 1 of an active set; else `NO_LIMIT`.

    A side with points of both kinds is at its friction.
    """
    rows = mask >> foot * ROWS_PER_FOOT
    points = [rows >> k * ROWS_PER_POINT & 0b11111 for k in range(POINTS_PER_FOOT)]
    at_limit = frozenset(k for k, active in enumerate(points) if active)
    if mask < 0 or not at_limit:
        return NO_LIMIT
    unloaded = all(points[k] & 0b10000 for k in at_limit)
    return f"{_SIDES[at_limit]}: {'unloaded' if unloaded else 'friction'}"


def sole_states(schema: Schema, rows: np.ndarray) -> tuple[np.ndarray, list[list[str]]]:
    """Return the first row of each span (n,), and for each foot the state in each span."""
    if not len(rows):
        return np.zeros(0, dtype=np.int64), [[] for _ in Foot]
    span = schema.column(rows, "time_ns").astype(np.int64) // SPAN_NS
    masks = np.maximum(schema.column(rows, "active_set").astype(np.int64), 0)
    first = np.flatnonzero(np.append(True, np.diff(span) != 0))
    active = np.bitwise_or.reduceat(masks, first).tolist()
    return first, [[sole_state(mask, k) for mask in active] for k in range(len(Foot))]
