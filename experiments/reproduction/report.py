"""Write a page of the results of `run`, with its trials and figures: `./wbc report`.

The page is `docs/results.md`, with figures in `docs/figures`. Each folder
`docs/results/trials/STUDY` has the table of trials, the study and its provenance. `./wbc check`
plays a sample of these trials again.
"""

from __future__ import annotations

import argparse
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from experiments.reproduction import five_g
from experiments.reproduction.claims import Claim, claims
from experiments.reproduction.constant_delays import (
    TABLE_II,
    TABLE_III,
    median_in_words,
    paper_tolerance,
)
from experiments.reproduction.layout import NONE, Table, in_markdown
from experiments.reproduction.provenance import how_it_was_made
from experiments.reproduction.results import FIGURE_FOLDER, Results
from experiments.reproduction.run import DEFAULT_OUT
from experiments.reproduction.sections import SECTIONS, STUDIES
from experiments.reproduction.verdict import RULE, Verdict
from shared.errors import ConfigError, writing
from shared.process.cli import EXIT_STANDING

_KEPT = ("study.toml", "trials.parquet", "about.json")
_FIGURES = {
    "fig4": (
        "Figure 4: an instance of the delay in each scenario",
        "Round trip of a message, by the time of its sending, over one shipped profile of each "
        "scenario.",
    ),
    "fig5": (
        "Figure 5: balance over a stalling link",
        "The link stalls for 155 ms from the end of the push (red). The axis of the violation is "
        "logarithmic.",
    ),
    "fig6": (
        "Figure 6: a walk of LA through two outages",
        "The contact violation rises with the age of the projector and falls when an answer comes. "
        "This also holds where the outage covers a contact switch (dotted, 2.6 s and 4.2 s). "
        "Around a switch the robot solves QPs itself. There is no measurement noise, as in the "
        "paper.",
    ),
}


def add_report_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `report`."""
    parser.add_argument(
        "--out", type=Path, default=DEFAULT_OUT, metavar="DIR", help="folder that `run` has written"
    )
    parser.add_argument(
        "--docs", type=Path, default=Path("docs"), metavar="DIR", help="folder of the page"
    )


def run_report(arguments: argparse.Namespace) -> int:
    """Write the page and copy its figures and trials. Print which conclusions hold."""
    results = Results(arguments.out)
    if not results.folder.is_dir():
        raise ConfigError(
            f"out: expected a folder of `wbc run`, got {results.folder}, which does not exist"
        )
    found = claims(results)
    page = arguments.docs / "results.md"
    with writing(arguments.docs, what="docs"):
        arguments.docs.mkdir(parents=True, exist_ok=True)
        page.write_text(report_text(results, found), encoding="utf-8")
        _copy(results, arguments.docs)
    for claim in found:
        print(claim)
    print(page)
    return EXIT_STANDING


def report_text(results: Results, found: Sequence[Claim]) -> str:
    """The page in Markdown: the outcomes at a glance, figures, conclusions, then every number."""
    parts = [
        "# The paper's tables and figures, reproduced",
        "This page has Tables II–VI and Figures 4–6 of H. Zhu et al., *Enabling Remote Whole-Body "
        "Control with 5G Edge Computing* (2020), with our trials beside the paper's numbers. PR "
        "applies the last torque received. LA applies the last projector to fresh feedback. LC, "
        "the project's controller, corrects a factorisation on the robot. *Full QP, 0 ms* solves "
        "the QP of every state without delay. `./wbc report` writes this page. "
        "[reproduction.md](reproduction.md) explains why numbers differ, and lists the "
        "assumptions that the paper leaves open.",
        *_missing(results),
        "## At a glance",
        in_markdown(_at_a_glance(results)),
        in_markdown(_summary(results)),
        "[How numbers are judged](#how-numbers-are-judged) has the rule of the verdicts.",
    ]
    for name, (title, caption) in _FIGURES.items():
        if (results.folder / FIGURE_FOLDER / f"{name}.png").is_file():
            picture = f"![{title}](figures/{name}.png)"
            parts += [f"## {title}", picture, f"{caption} ([SVG](figures/{name}.svg))"]
    parts += ["## The paper's conclusions, checked", in_markdown(_conclusions(found))]
    for section in sorted(SECTIONS.values(), key=lambda section: section.name):
        if tables := section.tables(results):
            parts += [f"## {section.title}", *(in_markdown(each, heading=True) for each in tables)]
    parts += ["## How numbers are judged", RULE]
    parts += ["## How it was made", *how_it_was_made(results)]
    return "\n\n".join(parts) + "\n"


def _at_a_glance(results: Results) -> Table:
    """The longest delay, and the part of the 5G links, that each controller stands."""
    lines = []
    for table in (TABLE_II, TABLE_III):
        median = {name: median_in_words(results, table, name) for name in ("pr", "la", "lc")}
        pr, la = (str(paper_tolerance(table, name)) for name in ("pr", "la"))
        what = f"{table.title}: longest round trip, median of the seeds [ms]"
        lines.append([what, median["pr"], pr, median["la"], la, median["lc"]])
    for scenario, task in five_g.CELLS:
        rates = five_g.outcomes(results, scenario, task)
        success = {
            name: f"{100 * each.rate:.0f} %" if each.played else NONE
            for name, each in rates.items()
        }
        pr, la = (f"{five_g.success_percent(scenario, task, name):.0f} %" for name in ("pr", "la"))
        what = f"Table IV, {scenario}, {task}: trials that stood"
        lines.append([what, success["pr"], pr, success["la"], la, success["lc"]])
    return Table("Limits and success", ["", "PR", "paper", "LA", "paper", "LC"], lines)


def _conclusions(found: Sequence[Claim]) -> Table:
    lines = [[each.verdict, each.sentence, each.because or NONE] for each in found]
    return Table("Conclusions", ["", "conclusion", "numbers"], lines)


def _missing(results: Results) -> list[str]:
    """Notes on studies that have not been played, and on studies played with `--quick`."""
    absent = [name for name in STUDIES if not results.rows(name)]
    absent += ["table5"] * (results.compute_times is None)
    absent += [
        name for name in _FIGURES if not (results.folder / FIGURE_FOLDER / f"{name}.png").is_file()
    ]
    short = [name for name in STUDIES if results.shortened(name)]
    short += ["table5"] * bool((results.compute_times_file or {}).get("quick"))
    notes = []
    if absent:
        notes.append(
            f"> **Incomplete.** Missing: {', '.join(absent)}. `./wbc run all"
            f"{' --quick' * bool(short)} --out {results.folder}` plays them."
        )
    if short:
        notes.append(f"> **Quick.** Played with `--quick`, on few seeds: {', '.join(short)}.")
    return notes


def _summary(results: Results) -> Table:
    lines = []
    for section in sorted(SECTIONS.values(), key=lambda section: section.name):
        counts = Counter(section.verdicts(results))
        judged = [Verdict.SAME_OR_BETTER, Verdict.SAME_ORDERING, Verdict.DIFFERS]
        if counts:
            numbers = [str(counts[each]) for each in judged]
            lines.append([section.title, str(sum(counts.values())), *numbers])
    columns = ["", "numbers", *(each.value for each in judged)]
    return Table("Verdicts", columns, lines)


def _copy(results: Results, docs: Path) -> None:
    """Copy figures and trials to the folder of the page."""
    for source in sorted((results.folder / FIGURE_FOLDER).glob("fig*")):
        target = docs / "figures" / source.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    for name in STUDIES:
        if results.rows(name):
            folder = docs / "results" / "trials" / name
            folder.mkdir(parents=True, exist_ok=True)
            for kept in _KEPT:
                shutil.copyfile(results.folder / name / kept, folder / kept)
