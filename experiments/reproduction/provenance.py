"""The provenance of a report's numbers: commands, machine, versions, and the time of each study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from experiments.reproduction.layout import Table, in_markdown
from experiments.reproduction.results import Results
from experiments.reproduction.sections import STUDIES
from experiments.studies.about import commit_in_words, other_codes_in_words

_PACKAGES = ("python", "mujoco", "pin", "daqp", "numpy")

About = dict[str, Any]


def how_it_was_made(results: Results) -> list[str]:
    """Paragraphs on the provenance, in Markdown."""
    abouts = {name: results.about(name) for name in STUDIES if results.rows(name)}
    if not abouts:
        return ["No study has been played."]
    quick = " --quick" if any(results.shortened(name) for name in abouts) else ""
    return [
        f"```sh\n./wbc run all{quick}\n./wbc report\n```",
        f"Machine: {_each(abouts, _machine)}. Versions: {_each(abouts, _versions)}. Commit: "
        f"{_each(abouts, _commit)}.",
        "Trials run on a simulated clock: the same configuration and seed give the same trial to "
        "the last bit. `./wbc check docs/results/trials/STUDY` plays a sample of the trials again "
        "and compares the rows. Seed k has the same noise and the same profile in every cell of a "
        "study.",
        in_markdown(_studies(results, abouts)),
    ]


def _studies(results: Results, abouts: Mapping[str, About]) -> Table:
    lines, trials, minutes = [], 0, 0.0
    for name, about in abouts.items():
        rows, took = results.rows(name), about["trial_seconds"] / 60
        failed = sum(row["error"] is not None for row in rows)
        lines.append(
            [
                f"[{name}](results/trials/{name}/study.toml)",
                str(len(rows)),
                str(len({row["seed"] for row in rows})),
                str(failed),
                f"{took:.1f}",
                f"{len(rows) / took:.1f}",
                about["date"][:16].replace("T", " "),
                other_codes_in_words(about),
            ]
        )
        trials, minutes = trials + len(rows), minutes + took
    lines.append(
        ["together", str(trials), "", "", f"{minutes:.1f}", f"{trials / minutes:.1f}", "", ""]
    )
    columns = ["study", "trials", "seeds", "ended with an error"]
    columns += ["core minutes", "trials per core minute", "finished", "trials of other code"]
    return Table("Studies", columns, lines)


def _each(abouts: Mapping[str, About], describe: Callable[[About], str]) -> str:
    """The descriptions of the studies, each different description once."""
    return "; ".join(dict.fromkeys(describe(about) for about in abouts.values()))


def _machine(about: About) -> str:
    machine = about["machine"]
    return f"{machine['cpu']}, {machine['cores']} cores, {about['workers']} workers"


def _versions(about: About) -> str:
    return ", ".join(f"{name} {about['versions'][name]}" for name in _PACKAGES)


def _commit(about: About) -> str:
    return f"{commit_in_words(about)} (code {about['code']})"
