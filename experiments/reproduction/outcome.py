"""The outcome of a cell: the trials that stood, and the paper's two errors over those trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from experiments.studies.trial_table import wilson_interval

Row = dict[str, Any]

CONTROLLERS = ("pr", "la", "lc")
COM_ERROR = "com_error_cm"
VIOLATION = "contact_violation_m_s2"
METRICS = (COM_ERROR, VIOLATION)
METRIC_IN_WORDS = {COM_ERROR: "CoM error [cm]", VIOLATION: "contact violation [m/s²]"}
_COLUMN = {COM_ERROR: ("com_error_m", 100.0), VIOLATION: ("contact_violation_m_s2", 1.0)}


@dataclass(frozen=True)
class Outcome:
    """The trials of one controller in one situation, without trials that ended with an error."""

    rows: tuple[Row, ...]

    @classmethod
    def of(cls, rows: Sequence[Row], **labels: Any) -> Outcome:
        """The outcome of the rows with these labels."""
        played = (row for row in rows if row["error"] is None)
        return cls(tuple(row for row in played if labels.items() <= row.items()))

    @property
    def played(self) -> int:
        """The number of trials."""
        return len(self.rows)

    @property
    def stood(self) -> int:
        """The number of trials that finished standing."""
        return len(self._standing)

    @property
    def rate(self) -> float:
        """The part of the trials that stood; 0 without trials."""
        return self.stood / self.played if self.played else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson interval of the rate, 95 %."""
        return wilson_interval(self.stood, self.played)

    def error(self, metric: str) -> float | None:
        """Mean of a metric over the trials that stood; None if all fell."""
        return _mean(list(self._standing.values()), metric)

    def beside(self, other: Outcome, metric: str) -> tuple[float, float] | None:
        """Means of this and another outcome over the networks and seeds in which both stood."""
        common = [key for key in self._standing if key in other._standing]
        ours = _mean([self._standing[key] for key in common], metric)
        theirs = _mean([other._standing[key] for key in common], metric)
        return None if ours is None or theirs is None else (ours, theirs)

    @property
    def _standing(self) -> dict[tuple[Any, Any], Row]:
        return {(row["network"], row["seed"]): row for row in self.rows if not row["fell"]}


def _mean(rows: Sequence[Row], metric: str) -> float | None:
    column, scale = _COLUMN[metric]
    values = [scale * row[column] for row in rows if row[column] is not None]
    return sum(values) / len(values) if values else None
