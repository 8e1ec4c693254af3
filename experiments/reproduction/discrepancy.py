"""Table VI: errors by the discrepancy between the active set in use and the true active set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from experiments.reproduction.layout import NONE, Table, number
from experiments.reproduction.outcome import COM_ERROR, METRICS, VIOLATION, Outcome, Row
from experiments.reproduction.published import published
from experiments.reproduction.results import Results
from experiments.reproduction.verdict import Verdict, verdict, within

STUDY = "table6"
TASKS = ("walk", "balance")
_NOTES = {
    "balance": " The paper's CoM errors in balance, 0.01 to 0.06 cm, cannot average to the 1.37 cm "
    "of its Table IV. If their unit were metres, they would be 1 to 6 cm."
}
_PREFIX = "active_set_discrepancy."
_COLUMN = {COM_ERROR: ("com_error_m", 100.0), VIOLATION: ("contact_violation_m_s2", 1.0)}


@dataclass(frozen=True)
class AtCardinality:
    """The ticks at one cardinality, and the mean of each metric over them."""

    ticks: int
    errors: dict[str, float]


def by_cardinality(rows: Sequence[Row]) -> list[AtCardinality]:
    """Ticks and mean errors of some trials, pooled, by cardinality 0, 1, 2, …"""
    longest = max((len(row[_PREFIX + "ticks"]) for row in rows), default=0)
    pooled = []
    for cardinality in range(longest):
        there = [row for row in rows if len(row[_PREFIX + "ticks"]) > cardinality]
        ticks = [row[_PREFIX + "ticks"][cardinality] for row in there]
        errors = {}
        for metric, (column, scale) in _COLUMN.items():
            values = [row[_PREFIX + column][cardinality] for row in there]
            known = [(n, value) for n, value in zip(ticks, values, strict=True) if n]
            if known:
                weighted = sum(n * value for n, value in known)
                errors[metric] = scale * weighted / sum(n for n, _ in known)
        pooled.append(AtCardinality(sum(ticks), errors))
    return pooled


def discrepancy_tables(results: Results) -> list[Table]:
    """Tables of walk and balance: LA beside the paper, then LC; [] if not played."""
    if not results.rows(STUDY):
        return []
    columns = [
        *("cardinality", "LA ticks", "CoM error [cm]", "paper", "verdict"),
        *("violation [m/s²]", "paper", "verdict"),
        *("LC ticks", "CoM error [cm]", "violation [m/s²]"),
    ]
    tables = []
    for task in TASKS:
        la, lc = (_pooled(results, task, name) for name in ("la", "lc"))
        printed = len(published()["table6"][task][COM_ERROR])
        lines = [
            [str(cardinality), *_la(la, task, cardinality), *_lc(lc, cardinality)]
            for cardinality in range(max(printed, len(la), len(lc)))
        ]
        note = f"Means over all ticks of {_trials(results, task)} trials in the burning building."
        tables.append(Table(f"Table VI, {task}", columns, lines, note=note + _NOTES.get(task, "")))
    return tables


def discrepancy_verdicts(results: Results) -> list[Verdict]:
    """Verdicts on all numbers of the paper's table."""
    verdicts = []
    for task in TASKS:
        la = _pooled(results, task, "la")
        for metric in METRICS:
            for cardinality in range(len(published()["table6"][task][metric])):
                verdicts.append(_verdict(la, task, metric, cardinality))
    return [each for each in verdicts if each is not Verdict.UNKNOWN]


def _pooled(results: Results, task: str, name: str) -> list[AtCardinality]:
    trials = Outcome.of(results.rows(STUDY), task=task, controller=name)
    return by_cardinality([row for row in trials.rows if not row["fell"]])


def _trials(results: Results, task: str) -> int:
    return Outcome.of(results.rows(STUDY), task=task, controller="la").stood


def _la(la: Sequence[AtCardinality], task: str, cardinality: int) -> list[str]:
    words = [_ticks(la, cardinality)]
    for metric in METRICS:
        paper = published()["table6"][task][metric]
        text = f"{paper[cardinality]:.2f}" if cardinality < len(paper) else NONE
        judged = _verdict(la, task, metric, cardinality)
        words += [number(_error(la, cardinality, metric)), text, judged.value]
    return words


def _lc(lc: Sequence[AtCardinality], cardinality: int) -> list[str]:
    errors = [number(_error(lc, cardinality, metric)) for metric in METRICS]
    return [_ticks(lc, cardinality), *errors]


def _ticks(pooled: Sequence[AtCardinality], cardinality: int) -> str:
    ticks = pooled[cardinality].ticks if cardinality < len(pooled) else 0
    return str(ticks) if ticks else NONE


def _error(pooled: Sequence[AtCardinality], cardinality: int, metric: str) -> float | None:
    return pooled[cardinality].errors.get(metric) if cardinality < len(pooled) else None


def _verdict(la: Sequence[AtCardinality], task: str, metric: str, cardinality: int) -> Verdict:
    """The verdict on one error; the ordering is that to the error at cardinality 0."""
    paper = published()["table6"][task][metric]
    ours, without = _error(la, cardinality, metric), _error(la, 0, metric)
    if ours is None or without is None or cardinality >= len(paper):
        return Verdict.UNKNOWN
    as_ordered = cardinality > 0 and (ours > without) == (paper[cardinality] > paper[0])
    return verdict(within(ours, paper[cardinality]), as_ordered)
