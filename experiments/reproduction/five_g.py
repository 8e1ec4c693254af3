"""Table IV: both scenarios of the 5G link, balance and walk."""

from __future__ import annotations

from experiments.reproduction.layout import NONE, Table, error_in_words, rate_in_words
from experiments.reproduction.outcome import (
    CONTROLLERS,
    METRIC_IN_WORDS,
    METRICS,
    Outcome,
)
from experiments.reproduction.published import published
from experiments.reproduction.results import Results
from experiments.reproduction.verdict import Verdict, error_verdict, rate_verdict

SCENARIOS = ("factory", "building")
TASKS = ("balance", "walk")
CELLS = tuple((scenario, task) for scenario in SCENARIOS for task in TASKS)
SHIPPED, GENERATED = "table4", "table4-generated"
_BESIDE = ["PR", "paper", "verdict", "LA", "paper", "verdict", "LC", "full QP, 0 ms"]


def outcomes(results: Results, scenario: str, task: str, *studies: str) -> dict[str, Outcome]:
    """Outcomes of each controller over the profiles of these studies together; default: both."""
    rows = [
        row
        for name in studies or (SHIPPED, GENERATED)
        for row in results.rows(name)
        if str(row["link.network"]).endswith(f":{scenario}")
    ]
    return {name: Outcome.of(rows, task=task, controller=name) for name in CONTROLLERS}


def five_g_tables(results: Results) -> list[Table]:
    """Tables of all profiles, of the shipped and of the generated ones; [] if not played."""
    played = [name for name in (SHIPPED, GENERATED) if results.rows(name)]
    if not played:
        return []
    lines = [line for scenario, task in CELLS for line in _lines(results, scenario, task)]
    columns = ["scenario", "task", "", *_BESIDE]
    tables = [Table(f"Table IV: {_profiles(results)}", columns, lines)]
    if len(played) == 2:
        tables += [_alone(results, SHIPPED), _alone(results, GENERATED)]
    return tables


def five_g_verdicts(results: Results) -> list[Verdict]:
    """Verdicts on all numbers of the paper's table."""
    verdicts = []
    for scenario, task in CELLS:
        found = outcomes(results, scenario, task)
        for name in ("pr", "la"):
            verdicts.append(_success(found, scenario, task, name)[1])
            verdicts += [_error(found, scenario, task, name, metric)[1] for metric in METRICS]
    return [verdict for verdict in verdicts if verdict is not Verdict.UNKNOWN]


def success_percent(scenario: str, task: str, name: str) -> float:
    """The paper's success rate of a controller [%]."""
    return float(published()["table4"][scenario]["success_percent"][task][name])


def _lines(results: Results, scenario: str, task: str) -> list[list[str]]:
    found = outcomes(results, scenario, task)
    full_qp = Outcome.of(results.rows("reference"), task=task)
    lines = [[scenario, task, "success"]]
    for name in ("pr", "la"):
        text, judged = _success(found, scenario, task, name)
        lines[0] += [rate_in_words(found[name]), text, judged.value]
    lines[0] += [rate_in_words(found["lc"]), rate_in_words(full_qp)]
    for metric in METRICS:
        line = [scenario, task, METRIC_IN_WORDS[metric]]
        for name in ("pr", "la"):
            text, judged = _error(found, scenario, task, name, metric)
            line += [error_in_words(found[name], metric, some=False), text, judged.value]
        line += [error_in_words(outcome, metric, some=False) for outcome in (found["lc"], full_qp)]
        lines.append(line)
    return lines


def _success(found: dict[str, Outcome], scenario: str, task: str, name: str) -> tuple[str, Verdict]:
    percent = success_percent(scenario, task, name)
    judged = rate_verdict(found[name], percent / 100, la=found["la"], pr=found["pr"])
    return f"{percent:.0f} %", judged


def _error(
    found: dict[str, Outcome], scenario: str, task: str, name: str, metric: str
) -> tuple[str, Verdict]:
    """The paper's error and its verdict. The paper prints no error if all its trials fell."""
    paper = published()["table4"][scenario][metric][task].get(name)
    if paper is None:
        return NONE, Verdict.UNKNOWN
    judged = error_verdict(
        found[name],
        paper,
        metric=metric,
        la=found["la"],
        pr=found["pr"],
        paper_rate=success_percent(scenario, task, name) / 100,
    )
    return f"{paper:.2f}", judged


def _alone(results: Results, study: str) -> Table:
    lines = []
    for scenario, task in CELLS:
        found = outcomes(results, scenario, task, study).values()
        lines.append([scenario, task, "success", *map(rate_in_words, found)])
        for metric in METRICS:
            errors = [error_in_words(outcome, metric, some=False) for outcome in found]
            lines.append([scenario, task, METRIC_IN_WORDS[metric], *errors])
    source = "shipped ns-3 profiles" if study == SHIPPED else "generated profiles"
    return Table(f"Of these, {source} alone", ["scenario", "task", "", "PR", "LA", "LC"], lines)


def _profiles(results: Results) -> str:
    """The number of profiles of each scenario, by source, in words."""
    counts = {
        source: len({row["seed"] for row in results.rows(name)})
        for name, source in ((SHIPPED, "shipped ns-3"), (GENERATED, "generated"))
    }
    text = " and ".join(f"{count} {source}" for source, count in counts.items() if count)
    return f"{text} profiles of each scenario"
