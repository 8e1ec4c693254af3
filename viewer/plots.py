"""The series that are plotted over time: their units, and their telemetry columns.

A 1 kHz signal is thinned to its least and its largest sample per `BUCKET_NS`, at their real times,
so that a spike of one tick is never hidden. Absent values (no projector yet, a lost message, a
joint hold without contact forces) are gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shared.robots import Foot
from shared.telemetry.outages import OUTAGE, PASSING, SILENT
from shared.telemetry.schema import Schema, Source
from shared.wbc.contacts import ROWS_PER_FOOT, ROWS_PER_POINT, ContactMode
from viewer.track import Colour

BUCKET_NS = 10_000_000
# In a fall both grow without bound and mean nothing. The plot should show the time before.
MAX_COM_ERROR_CM = 30.0
MAX_CONTACT_VIOLATION = 5.0  # m/s²

BLUE, ORANGE, GREEN, RED = (76, 142, 247), (255, 158, 44), (64, 191, 128), (235, 72, 72)
PURPLE, GREY, YELLOW = (178, 122, 240), (140, 148, 160), (250, 214, 80)
CYAN = (72, 202, 228)


@dataclass(frozen=True)
class Series:
    """The lines of one entity: a name and a colour for each, and values (n, lines) from rows."""

    path: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    values: Callable[[Schema, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class LinkSeries:
    """One direction of the link: delays as lines, lost messages as marks at the nominal delay."""

    direction: int
    name: str
    path: str
    lost_path: str
    colour: Colour


@dataclass(frozen=True)
class Lane:
    """A quantity with a few states, one at a time: their names and colours."""

    path: str
    states: dict[str, Colour]


LINKS = (
    LinkSeries(0, "uplink", "plots/delay/uplink", "plots/delay/uplink_lost", BLUE),
    LinkSeries(1, "downlink", "plots/delay/downlink", "plots/delay/downlink_lost", GREEN),
)
_LINK_STATES: dict[str, Colour] = {PASSING: (38, 70, 54), OUTAGE: RED, SILENT: (70, 74, 82)}
LINK_LANES = (Lane("lanes/uplink", _LINK_STATES), Lane("lanes/downlink", _LINK_STATES))
_SOURCE_COLOURS: dict[Source, Colour] = {
    Source.FRESH: GREEN,
    Source.CACHED: BLUE,
    Source.HELD: RED,
    Source.ON_BOARD: PURPLE,
    Source.CORRECTED: (52, 128, 140),
    Source.STOPPING: ORANGE,
}
SOURCE_LANE = Lane("lanes/command", {each.label: _SOURCE_COLOURS[each] for each in Source})
_MODE_COLOURS: dict[ContactMode, Colour] = {
    ContactMode.DOUBLE_SUPPORT: GREY,
    ContactMode.LEFT_SUPPORT: (176, 120, 48),
    ContactMode.RIGHT_SUPPORT: CYAN,
}
MODE_LANE = Lane("lanes/contact", {each.label: _MODE_COLOURS[each] for each in ContactMode})

OVERRUN_PATH = "plots/compute/overrun"
ACTIVE_SET_PATH = "plots/active_set"
N_ACTIVE_ROWS = len(Foot) * ROWS_PER_FOOT
# Empty rows between the two feet.
_FEET_APART = 3
ACTIVE_SET_HEIGHTS = np.arange(N_ACTIVE_ROWS) + _FEET_APART * (
    np.arange(N_ACTIVE_ROWS) // ROWS_PER_FOOT
)
_ROW_KINDS = ("friction +x", "friction -x", "friction +y", "friction -y", "least normal force")
ACTIVE_SET_NAMES = tuple(
    f"{foot.value} foot, point {1 + row // ROWS_PER_POINT}: {_ROW_KINDS[row % ROWS_PER_POINT]}"
    for foot in Foot
    for row in range(ROWS_PER_FOOT)
)
ACTIVE_SET_COLOURS = tuple(
    GREY if row % ROWS_PER_POINT == ROWS_PER_POINT - 1 else RED for row in range(N_ACTIVE_ROWS)
)


def active_rows(time_ns: np.ndarray, active_set: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the raster's bars: instants [ns], and heights (n, 40), NaN if a row is not active.

    `active_set` holds bit masks, negative for none. A row is drawn in a bucket if it is active in
    any of the bucket's ticks, so that one tick is never hidden. A span with one mask is given by
    its two ends.
    """
    if not len(time_ns):
        return np.zeros(0, dtype=np.int64), np.zeros((0, N_ACTIVE_ROWS))
    bucket = time_ns // BUCKET_NS
    first = np.flatnonzero(np.append(True, np.diff(bucket) != 0))
    masks = np.bitwise_or.reduceat(np.maximum(active_set.astype(np.int64), 0), first)
    begins = np.flatnonzero(np.append(True, np.diff(masks) != 0))
    starts = time_ns[first][begins]
    ends = np.append(starts[1:], time_ns[-1] + 1) - 1
    active = masks[begins, None] >> np.arange(N_ACTIVE_ROWS) & 1
    heights = np.where(active, ACTIVE_SET_HEIGHTS, np.nan)
    return np.column_stack([starts, ends]).ravel(), np.repeat(heights, 2, axis=0)


def milliseconds(nanoseconds: np.ndarray) -> np.ndarray:
    """Return milliseconds; NaN for a negative duration, which stands for an absent one."""
    return np.where(nanoseconds < 0, np.nan, nanoseconds * 1e-6)


TICK_SERIES = (
    Series(
        path="plots/projector_age",
        names=("projector age",),
        colours=(PURPLE,),
        values=lambda schema, rows: milliseconds(schema.column(rows, "projector_age_ns"))[:, None],
    ),
    Series(
        path="plots/com_error",
        names=("CoM error",),
        colours=(ORANGE,),
        values=lambda schema, rows: np.minimum(
            100.0 * schema.column(rows, "com_error_m")[:, None], MAX_COM_ERROR_CM
        ),
    ),
    Series(
        path="plots/contact_violation",
        names=("contact violation",),
        colours=(RED,),
        values=lambda schema, rows: np.minimum(
            schema.column(rows, "contact_violation_m_s2")[:, None], MAX_CONTACT_VIOLATION
        ),
    ),
    Series(
        path="plots/correction",
        names=("contraction", "staleness [rad]"),
        colours=(YELLOW, GREEN),
        values=lambda schema, rows: np.column_stack(
            [schema.column(rows, name) for name in ("contraction", "staleness_rad")]
        ),
    ),
    Series(
        path="plots/compute/tick",
        names=("robot tick", "tick late by"),
        colours=(BLUE, RED),
        values=lambda schema, rows: np.column_stack(
            [milliseconds(schema.column(rows, name)) for name in ("tick_ns", "late_ns")]
        ),
    ),
)

SOLVE_SERIES = Series(
    path="plots/compute/solve",
    names=("edge solve",),
    colours=(GREEN,),
    values=lambda schema, rows: milliseconds(schema.column(rows, "solve_ns"))[:, None],
)


def link_delay(schema: Schema, rows: np.ndarray) -> np.ndarray:
    """Return the delays of messages [ms], (n, 1); NaN for a lost message."""
    return milliseconds(schema.column(rows, "achieved_ns"))[:, None]


def peak_rows(time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the rows with an extreme of a column of `values` (n, k) in a bucket, by time."""
    if not len(time_ns):
        return np.zeros(0, dtype=np.int64)
    bucket = time_ns // BUCKET_NS
    kept = []
    for column in values.T:
        absent = np.isnan(column)
        by_least = np.lexsort((np.where(absent, np.inf, column), bucket))
        by_largest = np.lexsort((np.where(absent, -np.inf, column), bucket))
        last = np.append(np.flatnonzero(np.diff(bucket[by_least])), len(bucket) - 1)
        first = np.append(0, last[:-1] + 1)
        kept += [by_least[first], by_largest[last]]
    rows = np.unique(np.concatenate(kept))
    return rows[np.argsort(time_ns[rows], kind="stable")]
