"""Play the cases of a campaign, keep their outcomes in a journal, and write the page of promises.

The journal, `faults.jsonl` in --out, has a line for each case: seed, kind, fault, parameters and
outcome. A campaign that is started again plays the cases that are missing. Cases of fuzz and of
lockstep are played by several processes at a time, live ones alone and one after another.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from benchmarks.faults import fuzz, live, lockstep
from benchmarks.faults.cases import (
    FUZZ,
    KINDS,
    LATER,
    LIVE,
    LOCKSTEP,
    SHORT,
    WHOLE,
    Case,
    make_cases,
    select,
)
from benchmarks.faults.page import PAGE, evidence, with_evidence
from benchmarks.faults.promises import Outcome, broken
from benchmarks.termination import exit_at_termination
from experiments.studies.journal import Journal, Record, open_journal
from experiments.studies.workers import local_players, recorded
from shared.errors import ConfigError, writing
from shared.process.cli import EXIT_STANDING

JOURNAL = "faults.jsonl"
# The exit code of a campaign in which a promise is broken.
EXIT_BROKEN = 1
_ROOMS = {FUZZ: fuzz, LOCKSTEP: lockstep, LIVE: live}
_LATER = {LOCKSTEP: lockstep.LATER_DRAWS}
_MAX_WORKERS = 256

Played = dict[Case, Outcome | None]


def add_faults_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = __doc__
    parser.add_argument(
        "--short", action="store_true", help="play the short campaign: 2 minutes instead of an hour"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the cases (default 0)")
    parser.add_argument(
        "--kind", choices=KINDS, action="append", help="play only cases of this kind; repeatable"
    )
    parser.add_argument(
        "--only",
        metavar="CASE",
        action="append",
        help="play only this case, as in lockstep-017; repeatable",
    )
    parser.add_argument(
        "--played", action="store_true", help="use the cases in the journal; play no others"
    )
    parser.add_argument("--workers", type=int, default=1, help="number of processes (default 1)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/faults"),
        metavar="DIR",
        help="folder of the journal (default %(default)s)",
    )
    parser.add_argument(
        "--docs", type=Path, metavar="DIR", help=f"write the evidence into {PAGE} of this folder"
    )


def run_faults(arguments: argparse.Namespace) -> int:
    """Play the campaign. Return 0 if every promise is kept, else 1."""
    if not 1 <= arguments.workers <= _MAX_WORKERS:
        raise ConfigError(f"--workers: expected 1 to {_MAX_WORKERS}, got {arguments.workers}")
    if arguments.seed < 0:
        raise ConfigError(f"--seed: expected at least 0, got {arguments.seed}")
    exit_at_termination()
    cases = chosen(arguments.seed, short=arguments.short, kinds=arguments.kind, only=arguments.only)
    with writing(arguments.out, what="out"):
        arguments.out.mkdir(parents=True, exist_ok=True)
    with open_journal(arguments.out / JOURNAL) as journal:
        # A case that is asked for by its name is played again.
        known = {} if arguments.only else journal.usable(keep_code=False)
        if arguments.played:
            # A case that an error ended is evidence too: it breaks every promise of its kind.
            known |= journal.failed()
            cases = [case for case in cases if case.identity in known]
        played = play(cases, journal, known=known, workers=arguments.workers)
    if arguments.docs is not None:
        page = arguments.docs / PAGE
        with writing(page, what="docs"):
            text = with_evidence(page.read_text(encoding="utf-8"), evidence(played))
            page.write_text(text, encoding="utf-8")
    faulty = {case.name: broken(case, outcome) for case, outcome in played.items()}
    n_broken = sum(map(bool, faulty.values()))
    print(f"{len(played)} cases, {n_broken} break a promise; journal: {arguments.out / JOURNAL}")
    return EXIT_BROKEN if n_broken else EXIT_STANDING


def chosen(
    seed: int, *, short: bool, kinds: list[str] | None = None, only: list[str] | None = None
) -> list[Case]:
    """Return the cases of a campaign; the short one has the first ones of each kind."""
    whole = [
        case
        for kind in KINDS
        for case in make_cases(kind, _ROOMS[kind].DRAWS, later=_LATER.get(kind), seed=seed)
    ]
    if only:
        return select(whole, only)
    return [
        case
        for case in whole
        if (not kinds or case.kind in kinds) and (not short or _is_short(case))
    ]


def _is_short(case: Case) -> bool:
    """Return whether a case is in the short campaign: the first ones, and those of later faults."""
    later = _LATER.get(case.kind, {})
    first = LATER.get(case.kind, WHOLE[case.kind])
    return case.number < SHORT[case.kind] or first <= case.number < first + len(later)


def play(
    cases: Iterable[Case], journal: Journal, *, known: dict[str, Record], workers: int = 1
) -> Played:
    """Play the cases that are not known, and add them to the journal. Return all outcomes.

    A line is printed for each case. An outcome is None if an error ended the case.
    """
    cases = list(cases)
    played: Played = {
        case: known[case.identity]["summary"] for case in cases if case.identity in known
    }
    left = [case for case in cases if case not in played]
    if len(left) < len(cases):
        print(f"{len(cases) - len(left)} cases are in the journal already", flush=True)
    together = [case for case in left if case.kind != LIVE]
    if together:
        with local_players(min(workers, len(together)), play_case) as team:
            for case in together:
                team.submit(case)
            for _ in together:
                _note(*team.finished(), journal, played)
    for case in left:
        if case.kind == LIVE:
            _note(case, play_case(case), journal, played)
    return {case: played[case] for case in cases}


def play_case(case: Case) -> Record:
    """Play one case. Return its outcome, or the error that ended it."""
    return recorded(lambda: _ROOMS[case.kind].play(case))


def _note(case: Case, record: Record, journal: Journal, played: Played) -> None:
    journal.add(case, record)
    outcome: Outcome | None = record["summary"]
    played[case] = outcome
    if outcome is None:
        text = f"ERROR {record['error']}"
    elif "skipped" in outcome:
        text = f"skipped: {outcome['skipped']}"
    else:
        text = "; ".join(f"BROKEN {each}" for each in broken(case, outcome)) or "kept"
    print(f"{case.name}  {case.fault}, {record['wall_seconds']:.0f} s: {text}", flush=True)
