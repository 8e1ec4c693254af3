"""Play one trial from the command line, with the files and exit codes of a live run."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from experiments.lockstep import Lockstep, TrialResult
from shared.config.config_file import dump_config
from shared.config.settings import RunConfig
from shared.errors import writing
from shared.output.summary import summary_in_words
from shared.output.versions import versions
from shared.process.cli import EXIT_FELL, EXIT_STANDING, add_run_arguments, config_from
from shared.telemetry.parquet import write_parquet
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA


def add_trial_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `trial`."""
    add_run_arguments(parser)
    parser.add_argument(
        "--json", metavar="FILE", help="write the summary as JSON; - prints it, and nothing else"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for the run's files")


def run_trial(arguments: argparse.Namespace) -> int:
    """Play one trial. Return 0 if the robot stood, 3 if it fell."""
    config = config_from(arguments)
    if arguments.out is not None:
        with writing(arguments.out, what="out"):
            arguments.out.mkdir(parents=True, exist_ok=True)
    result = Lockstep(config).run()
    text = json.dumps(result.summary, indent=2) + "\n"
    # First, because a full disk should not hide the outcome.
    if arguments.json == "-":
        sys.stdout.write(text)
    else:
        print(summary_in_words(result.summary))
    if arguments.json not in (None, "-"):
        with writing(Path(arguments.json), what="json"):
            Path(arguments.json).write_text(text, encoding="utf-8")
    if arguments.out is not None:
        with writing(arguments.out, what="out"):
            write_run(arguments.out, config, result)
    return EXIT_FELL if result.summary["fell"] else EXIT_STANDING


def write_run(out: Path, config: RunConfig, result: TrialResult) -> None:
    """Write the files of a run that `deploy/up` writes, without logs and recording."""
    out.mkdir(parents=True, exist_ok=True)
    text = dump_config(config, versions=versions())
    (out / "config.toml").write_text(text, encoding="utf-8")
    text = json.dumps(result.summary, indent=2) + "\n"
    (out / "summary.json").write_text(text, encoding="utf-8")
    write_parquet(result.schema, result.rows, out / "telemetry.parquet")
    write_parquet(LINK_SCHEMA, result.link_rows, out / "link.parquet")
    write_parquet(SOLVE_SCHEMA, result.solve_rows, out / "edge.parquet")
