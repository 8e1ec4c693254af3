"""Limits from bisections: the largest value that each seed of each cell stands, and their median.

A bisection assumes that the robot is monotone: if it falls at some value of the setting, it falls
at every larger one. The limit is then the largest value that it stands, to within the resolution. A
robot that is not monotone stands again beyond a value at which it fell. The bisection then finds
one of several places where a standing and a falling value are that close, and not the largest value
that the robot stands. Only the values in the table were played.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from experiments.studies.study import Study, value_in_words
from experiments.studies.trial_table import errors_in_words
from shared.errors import ConfigError
from shared.output.text_table import aligned


@dataclass(frozen=True)
class Limit:
    """The limit of one seed of a cell.

    `label` has the settings that distinguish the cell, without the bisected setting and the seed.
    `standing` is the largest integer at which the robot stood, `low` if it never stood. `falling`
    is the smallest at which it fell, None if it stood at `high`. Both are None for an unfinished
    bisection: trials are missing, or a trial ended with an error.
    """

    label: dict[str, Any]
    seed: int
    standing: int | None
    falling: int | None


@dataclass(frozen=True)
class MedianInterval:
    """A median, and an interval that holds the true one with probability `coverage` or more."""

    median: float
    low: float
    high: float
    coverage: float


def limits(study: Study, rows: Sequence[dict[str, Any]]) -> list[Limit]:
    """The limit of every cell and seed, by cell and seed, from the rows of a sweep."""
    if study.bisection is None:
        raise ConfigError(f"study {study.name}: expected a study with [bisect], got one without")
    found = [
        Limit(study.cells[sequence.cell].shown, sequence.seed, *(sequence.bracket or (None, None)))
        for sequence, _ in study.sequences_of(rows)
    ]
    by_cell = [cell.shown for cell in study.cells]
    return sorted(found, key=lambda limit: by_cell.index(limit.label))


def median_interval(values: Sequence[float], *, confidence: float = 0.95) -> MedianInterval:
    """Median with a distribution-free interval from order statistics.

    The number of n independent values below the true median is binomial with p = 1/2. The median
    therefore lies between the k-th smallest and the k-th largest value with probability
    1 − 2 Σ_{i<k} C(n, i)/2ⁿ, or more if values coincide. k is the largest number with a coverage of
    at least `confidence`. If there is none (n < 6 for 95 %), k is 1 and `coverage` is less than
    `confidence`. A limit of which only a lower bound is known (the robot stood at `high`) may stand
    in as that bound.
    """
    if not values:
        raise ValueError("expected at least one value, got none")
    ordered, n = sorted(values), len(values)
    k = 1
    while 2 * (k + 1) <= n + 1 and _coverage(k + 1, n) >= confidence:
        k += 1
    median = (ordered[(n - 1) // 2] + ordered[n // 2]) / 2
    return MedianInterval(median, ordered[k - 1], ordered[n - k], _coverage(k, n))


def limits_in_words(study: Study, found: Sequence[Limit], rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line per cell: the limits of its seeds, and their median."""
    assert study.bisection is not None
    of, high = study.bisection, study.bisection.high
    settings = list(study.cells[0].shown)
    lines = [[*settings, "limits", "median", "interval of the median", "least", "most"]]
    for cell in study.cells:
        values = [
            limit.standing
            for limit in found
            if limit.label == cell.shown and limit.standing is not None
        ]
        named = [value_in_words(value) for value in cell.shown.values()]
        if not values:
            lines.append([*named, "0", *"----"])
            continue
        middle = median_interval(values)
        low, median, top, least, max_trials = (
            f"{'≥ ' * (value == high)}{value:g}"
            for value in (middle.low, middle.median, middle.high, min(values), max(values))
        )
        interval = f"{low} … {top} ({100 * middle.coverage:.1f} %)"
        lines.append([*named, str(len(values)), median, interval, least, max_trials])
    text = (
        f"the largest n that stood, {of.setting} = {value_in_words(of.values[of.setting])}, n from "
        f"{of.low} to {of.high}, resolution {of.resolution}"
    )
    return "\n".join([text, *aligned(lines), *errors_in_words(rows)])


def _coverage(k: int, n: int) -> float:
    return 1.0 - 2.0 * sum(math.comb(n, i) for i in range(k)) / 2.0**n
