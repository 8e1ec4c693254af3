"""Play trials of a finished sweep again and compare their rows: `check DIR --sample 20`.

`DIR` holds `study.toml`, `trials.parquet` and `about.json` of a sweep; the journal is not needed.
Rows are compared in every column except measured times. The comparison is exact if the machine and
the packages round like those of the sweep. Otherwise it uses the tolerances of
`experiments.studies.rounding`, and the command prints the reason.
"""

from __future__ import annotations

# isort: off
import shared.process.native_libraries  # noqa: F401

# isort: on
import argparse
import json
import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.about import commit_in_words
from experiments.studies.code_identity import code_version, present_identity
from experiments.studies.progress import Progress
from experiments.studies.rounding import ABSOLUTE, FALL_SECONDS, RELATIVE, beyond, differences
from experiments.studies.study import Study, value_in_words
from experiments.studies.study_file import read_study
from experiments.studies.sweep import workers_from
from experiments.studies.trial_sequence import Trial
from experiments.studies.trial_table import read_trials, row_of
from experiments.studies.workers import players
from shared.errors import ConfigError
from shared.output.screen import StatusLine
from shared.process.cli import EXIT_STANDING

EXIT_DIFFERENT = 1
# Fields of a summary with times measured on the machine, not simulated.
_MEASURED = ("robot_tick_ms.", "edge_solve_ms.", "realtime_factor")

Row = dict[str, Any]


@dataclass(frozen=True)
class Difference:
    """A row of the table that differs from the row of its trial played again; `text` tells how.

    `rounding`: the difference is within the tolerances for rounding.
    """

    number: int
    text: str
    rounding: bool = False


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `check`."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of a finished sweep")
    parser.add_argument(
        "--sample", type=int, metavar="N", default=10, help="number of trials (default %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="S", help="seed of the sample (default: a random one)"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes (default: all cores)"
    )
    parser.add_argument(
        "--exact",
        action="store_true",
        help="expect the same bits, also from other code or packages",
    )


def run_check(arguments: argparse.Namespace) -> int:
    """Play a sample again. Return 0 if all rows agree, 1 if one differs beyond rounding."""
    folder, workers = arguments.folder, workers_from(arguments.workers)
    if arguments.sample < 1:
        raise ConfigError(f"--sample: expected at least 1, got {arguments.sample}")
    rows, study = read_trials(folder).to_pylist(), read_study(folder)
    try:
        about = json.loads((folder / "about.json").read_text(encoding="utf-8"))
        code, commit = about["code"], commit_in_words(about)
        reasons = differences(about)
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError(
            f"expected the folder of a finished sweep, got {folder} without an about.json that "
            f"names its code ({type(error).__name__}); repeat the sweep"
        ) from None
    if present_identity(code) != code_version():
        # A change of the code may round otherwise and still compute the same.
        reasons.append(f"code {code} of commit {commit} there, {code_version()} here")
    seed = secrets.randbelow(2**32) if arguments.seed is None else arguments.seed
    if seed < 0:
        raise ConfigError(f"--seed: expected at least 0, got {seed}")
    print(_expected([] if arguments.exact else reasons))
    trials, different = matched(study, rows)
    numbers = sorted(trials)
    count = min(arguments.sample, len(numbers))
    drawn = sorted(np.random.default_rng(seed).choice(numbers, count, replace=False).tolist())
    played = {number: trials[number] for number in drawn}
    different += replayed(study, rows, played, workers, exact=arguments.exact or not reasons)
    for difference in sorted(different, key=lambda each: each.number):
        label = named(study, rows[difference.number])
        how = "differs by rounding" if difference.rounding else "differs"
        print(f"row {difference.number} ({label}) {how}: {difference.text}")
    rounded = sum(each.rounding for each in different)
    wrong = len(different) - rounded
    print(
        f"{count} of {len(rows)} trials played again (--seed {seed}): "
        + "; ".join(
            [
                *[f"rows that differ: {wrong}"] * (wrong > 0),
                *[f"rows that differ by rounding alone: {rounded}"] * (rounded > 0),
            ]
            or ["all rows identical"]
        )
    )
    return EXIT_DIFFERENT if wrong else EXIT_STANDING


def _expected(reasons: Sequence[str]) -> str:
    """The accuracy with which rows must agree on this machine, in words."""
    if not reasons:
        return "expected to the last bit"
    return (
        f"expected within {RELATIVE:g} (or {ABSOLUTE:g}), a fall within {FALL_SECONDS:g} s: "
        f"bits may differ because of {'; '.join(reasons)}"
    )


def matched(study: Study, rows: Sequence[Row]) -> tuple[dict[int, Trial], list[Difference]]:
    """The trials of a study by the number of their row, and a difference for every other row.

    A bisection is repeated with the outcomes in the rows. A row is not part of the study if the
    repeated bisection does not reach it.
    """
    trials = {
        number: trial
        for sequence, numbers in study.sequences_of(rows)
        for number, trial in zip(numbers, sequence.played, strict=True)
    }
    unknown = "the study has no such trial"
    if study.bisection is not None:
        unknown += ", or its bisection does not reach it from the other rows"
    strangers = [Difference(k, unknown) for k in range(len(rows)) if k not in trials]
    return trials, strangers


def replayed(
    study: Study, rows: Sequence[Row], trials: dict[int, Trial], workers: int, *, exact: bool = True
) -> list[Difference]:
    """Play trials again. Return the rows that differ from the new ones.

    Without `exact`, differences by rounding are marked as such.
    """
    number_of = {id(trial): number for number, trial in trials.items()}
    different = []
    progress = Progress(done=0, falls=0, left=len(trials))
    status = StatusLine(progress.line, stream=sys.stderr, stays=True)
    with status, players(workers) as team:
        for trial in trials.values():
            team.submit(trial)
        for left in reversed(range(len(trials))):
            trial, record = team.finished()
            again, number = row_of(trial, record, study.columns), number_of[id(trial)]
            if names := changed(rows[number], again):
                more = names if exact else beyond(rows[number], again, names)
                text = difference(rows[number], again, more or names)
                different.append(Difference(number, text, rounding=not more))
            progress.finished(fell=bool(again["fell"]), left=left)
    return different


def changed(row: Row, again: Row) -> list[str]:
    """The columns in which two rows differ, without measured times."""
    return [
        name
        for name in {**row, **again}
        if not name.startswith(_MEASURED)
        and (name not in row or name not in again or row[name] != again[name])
    ]


def difference(row: Row, again: Row, names: Sequence[str]) -> str:
    """The values of two rows in these columns, in words."""
    return "; ".join(
        f"{name} is {_cell(row, name)}, played again {_cell(again, name)}" for name in names
    )


def named(study: Study, row: Row) -> str:
    """The settings and the seed that distinguish a row, in words."""
    names = [*study.cells[0].shown, *study.varied, "seed"]
    shown = [name for name in dict.fromkeys(names) if name in row]
    return ", ".join(f"{name}={value_in_words(row[name])}" for name in shown)


def _cell(row: Row, name: str) -> str:
    return repr(row[name]) if name in row else "missing"
