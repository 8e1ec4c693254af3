"""Tables II and III: constant round trips, and the longest round trip that each seed stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from experiments.reproduction.layout import (
    FELL,
    NONE,
    Table,
    error_in_words,
    stood_in_words,
)
from experiments.reproduction.outcome import (
    COM_ERROR,
    CONTROLLERS,
    METRIC_IN_WORDS,
    METRICS,
    Outcome,
    Row,
)
from experiments.reproduction.published import published
from experiments.reproduction.results import Results
from experiments.reproduction.verdict import Verdict, error_verdict, verdict
from experiments.studies.bisection import median_interval

_ByName = dict[str, Outcome]


@dataclass(frozen=True)
class DelayTable:
    """The source of Table II or III on one plant.

    `label` is the column of its rows that holds the delay, `delay_format` the format of that
    column. The full QP without delay comes from the study `reference`. If that is None, it is LA's
    row at 0 ms.
    """

    title: str
    task: str
    paper: str
    study: str
    tolerance: str
    label: str = "link.network"
    delay_format: str = "constant:{}ms"
    reference: str | None = "reference"


TABLE_II = DelayTable("Table II, balance", "balance", "table2", "table2", "tolerance-balance")
TABLE_II_RIGID = DelayTable(
    "Table II, balance on ideal rigid contacts",
    "balance",
    "table2",
    "table2-rigid",
    "tolerance-balance-rigid",
    reference=None,
)
TABLE_III = DelayTable(
    "Table III, walk", "walk", "table3", "table3", "tolerance-walk", "cell", "{} ms"
)


def outcomes(rows: Sequence[Row], table: DelayTable) -> dict[int, _ByName]:
    """Outcomes of each controller by round trip [ms]."""
    before, after = table.delay_format.split("{}")
    delays = {int(row[table.label].removeprefix(before).removesuffix(after)) for row in rows}
    return {
        delay: {
            name: Outcome.of(
                rows, controller=name, **{table.label: table.delay_format.format(delay)}
            )
            for name in CONTROLLERS
        }
        for delay in sorted(delays)
    }


def delay_tables(results: Results, table: DelayTable) -> list[Table]:
    """Trials that stood, and each error, by delay, beside the paper's; [] if not played."""
    found = outcomes(results.rows(table.study), table)
    if not found:
        return []
    full_qp = _full_qp(results, table, found)
    stood = [_stood(table, delay, by_name, full_qp) for delay, by_name in found.items()]
    columns = ["round trip", "PR", "paper", "LA", "paper", "LC", "full QP, 0 ms"]
    tables = [Table(f"{table.title}: seeds standing (95 % interval)", columns, stood)]
    for metric in METRICS:
        lines = [
            [
                f"{delay} ms",
                *_beside_the_paper(table, delay, by_name, "pr", metric),
                *_beside_the_paper(table, delay, by_name, "la", metric),
                error_in_words(by_name["lc"], metric),
                error_in_words(full_qp, metric),
            ]
            for delay, by_name in found.items()
        ]
        beside = ["PR", "paper", "verdict", "LA", "paper", "verdict", "LC", "full QP, 0 ms"]
        title = f"{table.title}: {METRIC_IN_WORDS[metric]}"
        tables.append(Table(title, ["round trip", *beside], lines))
    return tables


def delay_verdicts(results: Results, table: DelayTable) -> list[Verdict]:
    """Verdicts on all numbers of the paper's table for which trials were played."""
    found = outcomes(results.rows(table.study), table)
    judged = [
        _verdict(table, delay, by_name, name, metric)
        for metric in METRICS
        for delay, by_name in found.items()
        for name in ("pr", "la")
    ]
    return [each for each in judged if each is not Verdict.UNKNOWN]


def tolerance_table(results: Results, tables: Sequence[DelayTable]) -> Table | None:
    """The longest delay that each seed stands, per controller; None without a bisection."""
    lines = [
        _tolerance_line(results, table, name)
        for table in tables
        for name in CONTROLLERS
        if tolerances(results, table, name)
    ]
    if not lines:
        return None
    return Table(
        "Maximal tolerable delay: the longest round trip that a seed stands [ms], by bisection",
        ["", "", "seeds", "median", "interval of the median", "least", "paper", "verdict"],
        lines,
        note="≥ marks the longest delay that was tried. A bisection assumes that a robot which "
        "falls at one delay falls at every longer one. The paper gives LA's limit. For PR the "
        "column *paper* has the longest delay of the paper's table at which PR did not fall.",
    )


def tolerances(results: Results, table: DelayTable, name: str) -> list[int]:
    """The limit of each seed of a controller [ms], shortest first; [] if not played."""
    return sorted(
        limit.standing
        for limit in results.limits(table.tolerance)
        if limit.label["controller"] == name and limit.standing is not None
    )


def paper_tolerance(table: DelayTable, name: str) -> int:
    """The longest delay at which the paper reports a controller standing [ms]."""
    paper = published()[table.paper]
    if name == "la":
        return int(paper["largest_delay_ms"])
    errors = zip(paper["delays_ms"], paper[COM_ERROR][name], strict=True)
    return max(int(delay) for delay, error in errors if error < float("inf"))


def _stood(table: DelayTable, delay: int, by_name: _ByName, full_qp: Outcome) -> list[str]:
    words = [f"{delay} ms"]
    for name in ("pr", "la"):
        error = _paper(table, COM_ERROR, delay, name)
        text = NONE if error is None else "fell" if error == float("inf") else "stood"
        words += [stood_in_words(by_name[name]), text]
    return [*words, stood_in_words(by_name["lc"]), stood_in_words(full_qp)]


def _beside_the_paper(
    table: DelayTable, delay: int, by_name: _ByName, name: str, metric: str
) -> list[str]:
    paper = _paper(table, metric, delay, name)
    text = NONE if paper is None else FELL if paper == float("inf") else f"{paper:.2f}"
    judged = _verdict(table, delay, by_name, name, metric)
    return [error_in_words(by_name[name], metric), text, judged.value]


def _verdict(table: DelayTable, delay: int, by_name: _ByName, name: str, metric: str) -> Verdict:
    paper = _paper(table, metric, delay, name)
    if paper is None:
        return Verdict.UNKNOWN
    return error_verdict(by_name[name], paper, metric=metric, la=by_name["la"], pr=by_name["pr"])


def _paper(table: DelayTable, metric: str, delay: int, name: str) -> float | None:
    """The paper's number; None for a delay that is not in the paper's table."""
    paper = published()[table.paper]
    if delay not in paper["delays_ms"]:
        return None
    return float(paper[metric][name][paper["delays_ms"].index(delay)])


def _full_qp(results: Results, table: DelayTable, found: dict[int, _ByName]) -> Outcome:
    if table.reference is None:
        return found[0]["la"] if 0 in found else Outcome(())
    return Outcome.of(results.rows(table.reference), task=table.task)


def median_in_words(results: Results, table: DelayTable, name: str) -> str:
    """The median of the longest delays that the seeds stand [ms]; – if not played."""
    values = tolerances(results, table, name)
    return _delay_in_words(results, table)(median_interval(values).median) if values else NONE


def _delay_in_words(results: Results, table: DelayTable) -> Callable[[float], str]:
    highest = {limit.standing for limit in results.limits(table.tolerance) if limit.falling is None}
    return lambda value: f"{'≥ ' if value in highest else ''}{value:g}"


def _tolerance_line(results: Results, table: DelayTable, name: str) -> list[str]:
    values = tolerances(results, table, name)
    found = median_interval(values)
    text = _delay_in_words(results, table)
    interval = f"{text(found.low)} … {text(found.high)} ({100 * found.coverage:.0f} %)"
    words = [table.title, name.upper(), str(len(values)), text(found.median), interval]
    if name == "lc":
        return [*words, text(values[0]), NONE, Verdict.UNKNOWN.value]
    paper = paper_tolerance(table, name)
    pr, la = (tolerances(results, table, each) for each in ("pr", "la"))
    ordered = bool(pr and la) and median_interval(la).median >= median_interval(pr).median
    judged = verdict(found.median >= paper, ordered)
    return [*words, text(values[0]), str(paper), judged.value]
