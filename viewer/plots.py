"""What is plotted: each series, its unit and the telemetry columns it comes from.

A 1 kHz signal is thinned to its least and its largest sample per `BUCKET_NS`, at the times they
really had, so that a spike of one tick is never hidden. Absent values (no projector yet, a lost
message, a joint hold without contact forces) are gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shared.report import SOURCES
from shared.telemetry import Schema

BUCKET_NS = 10_000_000

BLUE, ORANGE, GREEN, RED = (76, 142, 247), (255, 158, 44), (64, 191, 128), (235, 72, 72)
PURPLE, GREY, YELLOW = (178, 122, 240), (140, 148, 160), (250, 214, 80)

Colour = tuple[int, int, int]

# In the order of `SOURCES`: fresh, cached, held, on board, corrected, stopping.
SOURCE_COLOURS: tuple[Colour, ...] = (GREEN, BLUE, RED, PURPLE, GREY, ORANGE)
SOURCE_PATH = "plots/source"


@dataclass(frozen=True)
class Series:
    """Lines of one entity: a name and a colour per line, and their values (n, lines) from rows."""

    path: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    values: Callable[[Schema, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class LinkSeries:
    """One direction of the link: delays as lines, lost messages as marks at the nominal delay."""

    direction: int
    path: str
    lost_path: str


LINK_NAMES, LINK_COLOURS = ("nominal", "achieved"), (GREY, BLUE)
LINKS = (
    LinkSeries(direction=0, path="plots/uplink/delay", lost_path="plots/uplink/lost"),
    LinkSeries(direction=1, path="plots/downlink/delay", lost_path="plots/downlink/lost"),
)


def source_name(index: int) -> str:
    """Name of a command's source; a number where this viewer does not know it."""
    return SOURCES[index] if 0 <= index < len(SOURCES) else f"source {index}"


def milliseconds(nanoseconds: np.ndarray) -> np.ndarray:
    """Milliseconds, NaN where negative: a negative duration stands for an absent one."""
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
        values=lambda schema, rows: 100.0 * schema.column(rows, "com_error_m")[:, None],
    ),
    Series(
        path="plots/contact_violation",
        names=("contact violation",),
        colours=(RED,),
        values=lambda schema, rows: schema.column(rows, "contact_violation_m_s2")[:, None],
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


def link_delays(schema: Schema, rows: np.ndarray) -> np.ndarray:
    """Nominal and achieved delay [ms] of messages, (n, 2); NaN achieved where lost."""
    return np.column_stack(
        [milliseconds(schema.column(rows, name)) for name in ("nominal_ns", "achieved_ns")]
    )


def peak_rows(time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Rows that hold an extreme sample of any column of `values` (n, k) in its bucket, by time."""
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
