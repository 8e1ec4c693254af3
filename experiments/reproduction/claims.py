"""The paper's conclusions, with the verdict of our trials on each and the numbers behind it."""

from __future__ import annotations

from dataclasses import dataclass

from experiments.reproduction import five_g
from experiments.reproduction.computation import local_is_cheaper
from experiments.reproduction.constant_delays import (
    TABLE_II,
    TABLE_II_RIGID,
    TABLE_III,
    DelayTable,
    outcomes,
    paper_tolerance,
    tolerances,
)
from experiments.reproduction.layout import FELL, number, rate_in_words
from experiments.reproduction.outcome import (
    COM_ERROR,
    METRIC_IN_WORDS,
    VIOLATION,
    Outcome,
)
from experiments.reproduction.results import Results
from experiments.reproduction.verdict import no_worse
from experiments.studies.bisection import median_interval


@dataclass(frozen=True)
class Claim:
    """A conclusion, whether it holds (None: not played), and the numbers that show it."""

    sentence: str
    holds: bool | None
    because: str = ""

    @property
    def verdict(self) -> str:
        """The truth of the sentence in words."""
        return {True: "holds", False: "does not hold", None: "not played"}[self.holds]

    def __str__(self) -> str:
        return f"{self.verdict}: {'; '.join(filter(None, (self.sentence, self.because)))}"


def claims(results: Results) -> list[Claim]:
    """All conclusions, in the order of the tables."""
    tables = (TABLE_II, TABLE_II_RIGID, TABLE_III)
    return [
        *(no_worse_at_every_delay(results, table, VIOLATION) for table in tables),
        *(no_worse_at_every_delay(results, table, COM_ERROR) for table in tables),
        *(tolerates(results, table) for table in tables),
        *(remote_falls(results, table) for table in tables),
        *(success(results, scenario, task) for scenario, task in five_g.CELLS),
        *(remote_walk_falls(results, scenario) for scenario in five_g.SCENARIOS),
        Claim(
            "Table V: the local controller takes less time than the QP", *local_is_cheaper(results)
        ),
    ]


def no_worse_at_every_delay(results: Results, table: DelayTable, metric: str) -> Claim:
    """The claim that LA's error is at most PR's, at each delay at which LA or PR stood."""
    name, _, _ = METRIC_IN_WORDS[metric].partition(" [")
    sentence = f"{table.title}: LA's {name} ≤ PR's at every delay"
    found = outcomes(results.rows(table.study), table)
    compared = {
        delay: (by_name["la"], by_name["pr"])
        for delay, by_name in found.items()
        if by_name["la"].stood or by_name["pr"].stood
    }
    if not compared:
        return Claim(sentence, None)
    worse = [delay for delay, (la, pr) in compared.items() if not no_worse(la, pr, metric)]
    text = [f"{delay} ms {_pair(la, pr, metric)}" for delay, (la, pr) in compared.items()]
    because = f"LA / PR over the seeds in which both stood: {', '.join(text)}"
    if worse:
        because = f"not so at {', '.join(map(str, worse))} ms; {because}"
    return Claim(sentence, not worse, because)


def tolerates(results: Results, table: DelayTable) -> Claim:
    """The claim that every seed of LA stands the longest delay that the paper's LA stands."""
    paper = paper_tolerance(table, "la")
    sentence = f"{table.title}: LA stands the paper's longest delay, {paper} ms, with every seed"
    found = tolerances(results, table, "la")
    if not found:
        return Claim(sentence, None)
    median = median_interval(found).median
    because = f"longest delay of {len(found)} seeds: least {found[0]} ms, median {median:g} ms"
    return Claim(sentence, found[0] >= paper, because)


def remote_falls(results: Results, table: DelayTable) -> Claim:
    """The claim that PR falls at every delay above the longest that the paper's PR stands."""
    found = outcomes(results.rows(table.study), table)
    falls = [delay for delay in found if delay > paper_tolerance(table, "pr")]
    sentence = f"{table.title}: PR always falls beyond {paper_tolerance(table, 'pr')} ms"
    pr = {delay: found[delay]["pr"] for delay in falls if found[delay]["pr"].played}
    if not pr:
        return Claim(sentence, None)
    text = ", ".join(f"{outcome.stood}/{outcome.played} at {d} ms" for d, outcome in pr.items())
    return Claim(sentence, not any(outcome.stood for outcome in pr.values()), f"stood {text}")


def success(results: Results, scenario: str, task: str) -> Claim:
    """The claim that LA's success rate in a cell of Table IV is at least the paper's."""
    paper = five_g.success_percent(scenario, task, "la")
    sentence = f"Table IV, {scenario}, {task}: LA's success ≥ the paper's {paper:.0f} %"
    la = five_g.outcomes(results, scenario, task)["la"]
    if not la.played:
        return Claim(sentence, None)
    return Claim(sentence, la.rate >= paper / 100, rate_in_words(la))


def remote_walk_falls(results: Results, scenario: str) -> Claim:
    """The claim that PR falls in every walk of a scenario, as in the paper."""
    sentence = f"Table IV, {scenario}, walk: PR always falls"
    pr = five_g.outcomes(results, scenario, "walk")["pr"]
    if not pr.played:
        return Claim(sentence, None)
    return Claim(sentence, pr.stood == 0, f"stood {rate_in_words(pr)}")


def _pair(la: Outcome, pr: Outcome, metric: str) -> str:
    both = la.beside(pr, metric)
    ours, theirs = both or (la.error(metric), pr.error(metric))
    return " / ".join(FELL if value is None else number(value) for value in (ours, theirs))
