"""Play the trials of the paper's tables and figures and print them: `./wbc run table2 fig5 …`.

Each study has a folder below `--out`, which keeps finished trials. The same command therefore
continues after an interruption. A study that several tables share is played once.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.reproduction.compute_times import QUICK_SECONDS, measure
from experiments.reproduction.figures import FIGURES
from experiments.reproduction.layout import in_columns
from experiments.reproduction.results import COMPUTE_TIMES, FIGURE_FOLDER, Results
from experiments.reproduction.sections import SECTIONS
from experiments.studies.code_identity import code_version
from experiments.studies.study_file import read_study
from experiments.studies.sweep import sweep, workers_from
from shared.commands import wbc
from shared.errors import ConfigError, one_of, writing
from shared.process.cli import EXIT_STANDING

ALL = "all"
# Computation times come first, while the cores are idle; the cheapest tables and figures follow.
NAMES = ("table5", *FIGURES, *(name for name in SECTIONS if name != "table5"))
DEFAULT_OUT = Path("runs") / "reproduction"
QUICK_OUT = Path("runs") / "reproduction-quick"


def add_reproduction_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `run`."""
    parser.add_argument(
        "names", nargs="+", metavar="NAME", help=f"{', '.join(sorted(NAMES))}, or {ALL}"
    )
    parser.add_argument(
        "--quick", action="store_true", help="play fewer seeds and delays, in minutes"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes (default: all cores)"
    )
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:8786", help="play on the Dask cluster of this scheduler"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder of the studies (default {DEFAULT_OUT}, with --quick {QUICK_OUT})",
    )
    parser.add_argument("--keep-code", action="store_true", help="also use trials of other code")


def run_reproduction(arguments: argparse.Namespace) -> int:
    """Play, measure and draw the named tables and figures. Print each table."""
    names = chosen(arguments.names)
    if arguments.scheduler is not None and arguments.workers is not None:
        raise ConfigError("--workers: expected without --scheduler, got both; leave out --workers")
    workers_from(arguments.workers)  # an invalid number is an error before any trial is played
    out = arguments.out or (QUICK_OUT if arguments.quick else DEFAULT_OUT)
    try:
        with writing(out, what="out"):
            _run(names, out, arguments)
    except KeyboardInterrupt:
        print("interrupted; the same command continues", file=sys.stderr)
        raise
    return EXIT_STANDING


def chosen(names: Sequence[str]) -> list[str]:
    """The names to run, in the order of NAMES; ConfigError for an unknown name."""
    for name in names:
        if name not in (*NAMES, ALL):
            raise ConfigError(f"run: {one_of([*sorted(NAMES), ALL], name)}")
    return [name for name in NAMES if name in names or ALL in names]


def _run(names: Sequence[str], out: Path, arguments: argparse.Namespace) -> None:
    needed = (SECTIONS[name].studies for name in names if name in SECTIONS)
    studies = list(dict.fromkeys(study for names in needed for study in names))
    for number, name in enumerate(names, start=1):
        _say(f"{name}, {number} of {len(names)}")
        if name in FIGURES:
            FIGURES[name](out / FIGURE_FOLDER)
            continue
        if name == "table5":
            _measure(out, quick=arguments.quick)
        for study in SECTIONS[name].studies:
            if study in studies:
                _say(f"{name}: study {study}, {len(studies)} to go")
                _play(study, out, arguments)
                studies.remove(study)
        for table in SECTIONS[name].tables(Results(out)):
            print(f"\n{in_columns(table)}")
        print(flush=True)
    _say(f"done: {out}; {wbc(f'report --out {out}')} makes a page of the results")


def _play(name: str, out: Path, arguments: argparse.Namespace) -> None:
    sweep(
        read_study(name, quick=arguments.quick),
        out=out / name,
        workers=workers_from(arguments.workers),
        scheduler=arguments.scheduler,
        keep_code=arguments.keep_code,
    )


def _measure(out: Path, *, quick: bool) -> None:
    """Measure computation times, unless the folder has those of this code."""
    about = {"code": code_version(), "quick": quick}
    kept = Results(out).compute_times_file
    if kept is not None and about.items() <= kept.items():
        return
    measured = measure(seconds=QUICK_SECONDS if quick else None)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps({**about, "measured": measured.as_json()}, indent=2) + "\n"
    (out / COMPUTE_TIMES).write_text(text, encoding="utf-8")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
