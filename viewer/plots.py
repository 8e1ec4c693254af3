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
from shared.telemetry.schema import Schema, Source
from shared.wbc.contacts import ContactMode
from viewer.colours import (
    COM,
    FALLEN,
    LIMIT,
    LINE,
    LINK_STATES,
    MODES,
    SECOND_LINE,
    SOURCES,
    Colour,
)
from viewer.soles import SOLE_STATES

BUCKET_NS = 10_000_000
# In a fall both grow without bound and mean nothing. The plot should show the time before.
MAX_COM_ERROR_CM = 30.0
MAX_CONTACT_VIOLATION = 5.0  # m/s²


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


@dataclass(frozen=True)
class Lane:
    """A quantity with a few states, one at a time: their names and colours."""

    path: str
    states: dict[str, Colour]


LINKS = (
    LinkSeries(0, "uplink", "plots/delay/uplink", "plots/delay/uplink/lost"),
    LinkSeries(1, "downlink", "plots/delay/downlink", "plots/delay/downlink/lost"),
)
# A lane is drawn under its path, in the order of the paths.
LINK_LANES = (Lane("link/uplink", LINK_STATES), Lane("link/downlink", LINK_STATES))
SOURCE_LANE = Lane(
    "robot/command", {each.label: SOURCES[each] for each in Source} | {FALLEN: LIMIT}
)
MODE_LANE = Lane("robot/planned_contact", {each.label: MODES[each] for each in ContactMode})
SOLE_LANES = tuple(Lane(f"soles_at_a_limit/{foot.value}_foot", SOLE_STATES) for foot in Foot)
LANES = (*LINK_LANES, SOURCE_LANE, MODE_LANE, *SOLE_LANES)

OVERRUN_PATH = "plots/compute/tick/overrun"


def milliseconds(nanoseconds: np.ndarray) -> np.ndarray:
    """Return milliseconds; NaN for a negative duration, which stands for an absent one."""
    return np.where(nanoseconds < 0, np.nan, nanoseconds * 1e-6)


TICK_SERIES = (
    Series(
        path="plots/projector_age",
        names=("age",),
        colours=(LINE,),
        values=lambda schema, rows: milliseconds(schema.column(rows, "projector_age_ns"))[:, None],
    ),
    Series(
        path="plots/com_error",
        names=("CoM error",),
        colours=(COM,),
        values=lambda schema, rows: np.minimum(
            100.0 * schema.column(rows, "com_error_m")[:, None], MAX_COM_ERROR_CM
        ),
    ),
    Series(
        path="plots/contact_violation",
        names=("contact violation",),
        colours=(LINE,),
        values=lambda schema, rows: np.minimum(
            schema.column(rows, "contact_violation_m_s2")[:, None], MAX_CONTACT_VIOLATION
        ),
    ),
    Series(
        path="plots/correction/contraction",
        names=("contraction",),
        colours=(LINE,),
        values=lambda schema, rows: schema.column(rows, "contraction")[:, None],
    ),
    Series(
        path="plots/correction/staleness",
        names=("staleness",),
        colours=(LINE,),
        values=lambda schema, rows: schema.column(rows, "staleness_rad")[:, None],
    ),
    Series(
        path="plots/compute/tick",
        names=("computation", "lateness"),
        colours=(LINE, SECOND_LINE),
        values=lambda schema, rows: np.column_stack(
            [milliseconds(schema.column(rows, name)) for name in ("tick_ns", "late_ns")]
        ),
    ),
)

SOLVE_SERIES = Series(
    path="plots/compute/solve",
    names=("edge solve",),
    colours=(LINE,),
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
