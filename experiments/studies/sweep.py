"""Play a study: many trials on all cores, stored as they finish, and written to one table.

The same command continues after an interruption. It plays trials that ended with an error again.
The next trial of a bisection depends only on the outcomes of the trials before it, not on the time
or the worker. `trials.parquet` has the columns of the study, `study.toml` the study, and
`about.json` its provenance. `trials.jsonl` is the journal of finished trials.
"""

from __future__ import annotations

# isort: off
import shared.process.native_libraries  # noqa: F401

# isort: on
import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from experiments.studies.about import about_now, commit_in_words, other_codes, other_codes_in_words
from experiments.studies.bisection import limits, limits_in_words
from experiments.studies.journal import Record, open_journal
from experiments.studies.progress import Progress
from experiments.studies.study import Study
from experiments.studies.study_file import read_study
from experiments.studies.trial_sequence import Outcome, Trial, TrialSequence, outcome_of
from experiments.studies.trial_table import row_of, table_in_words, write_trials
from experiments.studies.workers import EXAMPLE, Players, players
from shared.errors import ConfigError
from shared.output.screen import StatusLine
from shared.process.cli import EXIT_STANDING


def add_sweep_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sweep`."""
    parser.add_argument("study", metavar="STUDY", help="a shipped study or a TOML file")
    parser.add_argument("--quick", action="store_true", help="apply the study's table [quick]")
    parser.add_argument(
        "--seeds", type=int, metavar="N", help="number of seeds, in place of the study's"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes (default: all cores)"
    )
    parser.add_argument(
        "--scheduler",
        metavar=EXAMPLE,
        help="play on the Dask cluster of this scheduler",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the trials (default runs/sweep-STUDY)"
    )
    parser.add_argument(
        "--only",
        action="append",
        metavar="NAME",
        help="play only this cell, or cells such as controller=la; repeatable",
    )
    parser.add_argument(
        "--table", type=Path, metavar="FILE", help="also write the table to this file"
    )
    parser.add_argument("--keep-code", action="store_true", help="also use trials of other code")


def run_sweep(arguments: argparse.Namespace) -> int:
    """Play a study and print its table."""
    study = read_study(arguments.study, seeds=arguments.seeds, quick=arguments.quick)
    if arguments.scheduler is not None and arguments.workers is not None:
        raise ConfigError("--workers: expected without --scheduler, got both; leave out --workers")
    name = f"{study.name}-quick" if arguments.quick else study.name
    out = arguments.out or Path("runs") / f"sweep-{name}"
    rows = sweep(
        study,
        out=out,
        workers=workers_from(arguments.workers),
        scheduler=arguments.scheduler,
        only=arguments.only or (),
        keep_code=arguments.keep_code,
    )
    if study.bisection is None:
        table = table_in_words(rows, list(study.cells[0].shown))
    else:
        table = limits_in_words(study, limits(study, rows), rows)
    print(table)
    if arguments.table is not None:
        options = [*["--quick"] * arguments.quick, f"--seeds {study.seeds}"]
        _write_table(arguments.table, table, f"{study.name} {' '.join(options)}", out)
    return EXIT_STANDING


def workers_from(asked: int | None) -> int:
    """The number of worker processes: `--workers`, or else the number of cores."""
    if asked is None:
        return len(os.sched_getaffinity(0))
    if asked < 1:
        raise ConfigError(f"--workers: expected at least 1, got {asked}")
    return asked


def sweep(
    study: Study,
    *,
    out: Path,
    workers: int = 1,
    scheduler: str | None = None,
    only: Sequence[str] = (),
    keep_code: bool = False,
) -> list[dict[str, Any]]:
    """Play the trials that `out` does not have yet. Return the rows of all, by cell and seed.

    The trials run on `workers` processes or, if `scheduler` is an address, on the Dask cluster
    there. `only` names the cells to play; empty stands for all.
    """
    chosen = study.only(only)
    try:
        out.mkdir(parents=True, exist_ok=True)
        study_text = tomli_w.dumps(study.table)
        with open_journal(out / "trials.jsonl") as journal:
            (out / "study.toml").write_text(study_text, encoding="utf-8")
            records = journal.usable(keep_code=keep_code)
            sequences = _followed(study, records)
            of_study = _identities(_followed(study, journal.usable(keep_code=True)))
            if text := journal.left_out(of_study, keep_code=keep_code):
                print(text, file=sys.stderr)
            missing = [
                sequence
                for sequence in sequences
                if sequence.next is not None and (not only or sequence.cell in chosen)
            ]
            kept = [records[trial.identity] for sequence in sequences for trial in sequence.played]
            falls = sum(record["summary"]["fell"] for record in kept)
            progress = Progress(done=len(kept), falls=falls, left=study.max_left(missing))
            if missing:
                status = StatusLine(progress.line, stream=sys.stderr, stays=True)
                with status, players(workers, scheduler) as team:
                    workers = team.number
                    for trial, record in _playing(missing, records, team):
                        journal.add(trial, record)
                        row_of(trial, record, study.columns)  # raises for an unknown column
                        fell = record["error"] is None and record["summary"]["fell"]
                        progress.finished(fell=fell, left=study.max_left(missing))
            made = progress.about() | {"workers": workers, "scheduler": scheduler}
        played = [
            (trial, records[trial.identity])
            for sequence in sorted(sequences, key=lambda sequence: sequence.cell)
            for trial in sequence.played
        ]
        rows = [row_of(trial, record, study.columns) for trial, record in played]
        write_trials(rows, out)
        # An earlier sweep may have been killed between its last trial and this file.
        if missing or not (out / "about.json").is_file():
            about = about_now(study) | made
            about["trial_seconds"] = sum(record["wall_seconds"] for _, record in played)
            about["other_code"] = other_codes(record for _, record in played)
            (out / "about.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        where = error.filename or out
        raise ConfigError(f"out: cannot write {where}: {error.strerror or error}") from None
    except KeyboardInterrupt:
        print(f"interrupted; the same command continues in {out}", file=sys.stderr)
        raise
    return rows


def _followed(study: Study, records: Mapping[str, Record]) -> list[TrialSequence]:
    """Every sequence of a study, advanced as far as its trials have been played."""
    sequences = study.sequences()
    for sequence in sequences:
        sequence.follow(_outcome_in(records))
    return sequences


def _outcome_in(records: Mapping[str, Record]) -> Callable[[Trial], Outcome | None]:
    def outcome(trial: Trial) -> Outcome | None:
        record = records.get(trial.identity)
        return None if record is None else outcome_of(record["error"], record["summary"])

    return outcome


def _identities(sequences: Sequence[TrialSequence]) -> set[str]:
    """Identities of the trials played, and of the next trials."""
    known = {trial.identity for sequence in sequences for trial in sequence.played}
    return known | {sequence.next.identity for sequence in sequences if sequence.next is not None}


def _playing(
    sequences: Sequence[TrialSequence], records: dict[str, Record], team: Players[Trial]
) -> Iterator[tuple[Trial, Record]]:
    """Play sequences to their ends. Yield each trial and its record, and add it to `records`."""
    going = {(sequence.cell, sequence.seed): sequence for sequence in sequences}
    for sequence in sequences:
        assert sequence.next is not None
        team.submit(sequence.next)
    while going:
        trial, record = team.finished()
        records[trial.identity] = record
        sequence = going[trial.cell, trial.config.seed]
        sequence.follow(_outcome_in(records))
        if sequence.next is None:
            del going[sequence.cell, sequence.seed]
        else:
            team.submit(sequence.next)
        yield trial, record


def _write_table(path: Path, table: str, asked: str, out: Path) -> None:
    """Write the table with its provenance on top; `asked` is the study and its options."""
    try:
        about = json.loads((out / "about.json").read_text(encoding="utf-8"))
        made = about["versions"]
        commit = ", ".join(filter(None, [commit_in_words(about), other_codes_in_words(about)]))
        packages = ", ".join(f"{name} {made[name]}" for name in ("python", "mujoco", "pin", "daqp"))
        lines = [
            about["description"],
            f"./wbc sweep {asked}",
            f"{about['machine']['cpu']}; {packages}; commit {commit}, "
            f"{about['date'][:10]}; means over the trials that finished standing",
            "",
            table,
        ]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"table: cannot write {path}: {error.strerror}") from None
