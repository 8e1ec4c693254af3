"""Play one trial from the command line, with the files and exit codes of a live run."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path

from experiments.lockstep import Lockstep, TrialResult
from shared.config.config_file import dump_config
from shared.config.settings import RunConfig
from shared.errors import ConfigError, writing
from shared.output.screen import StatusLine
from shared.output.summary import summary_in_words
from shared.process.cli import EXIT_FELL, EXIT_STANDING
from shared.process.run_options import add_run_arguments, config_from
from shared.telemetry.parquet import write_parquet
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA
from shared.wire.operator.events import EVENTS_FILE, CommandEvent, read_events, write_events

# A shorter trial has no line of progress.
_QUIET_SECONDS = 2.0


def add_trial_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `trial`."""
    add_run_arguments(parser)
    parser.add_argument(
        "--json", metavar="FILE", help="write the summary as JSON; - prints it, and nothing else"
    )
    parser.add_argument(
        "--events",
        metavar="RUN",
        type=Path,
        help="play a run again from its folder: its settings, and its commands at the times of "
        "their effects; or FILE: commands for the run that the flags describe, one a line, as in "
        "'2.5s link cut'",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for the run's files")
    parser.add_argument(
        "--force", action="store_true", help="replace files that --out or --json have already"
    )


def run_trial(arguments: argparse.Namespace) -> int:
    """Play one trial. Return 0 if the robot stood, 3 if it fell."""
    config, events = _config_and_events(arguments)
    out: Path | None = arguments.out
    json_file = Path(arguments.json) if arguments.json not in (None, "-") else None
    _check_free(out, json_file, force=arguments.force)
    if out is not None:
        with writing(out, what="out"):
            out.mkdir(parents=True, exist_ok=True)
    trial = Lockstep(config, events=events)
    begun = time.monotonic()

    def progress() -> str:
        played = trial.robot.time_ns * 1e-9
        rate = played / (time.monotonic() - begun)
        return f"played {played:.1f} of {config.duration:g} s, {rate:.2g} × real time"

    with StatusLine(progress, stream=sys.stderr, quiet=_QUIET_SECONDS):
        result = trial.run()
    text = json.dumps(result.summary, indent=2) + "\n"
    # First, because a full disk should not hide the outcome.
    if arguments.json == "-":
        sys.stdout.write(text)
    else:
        print(summary_in_words(result.summary))
        print("  no files; --out DIR keeps them" if out is None else f"  files: {out}")
    if json_file is not None:
        with writing(json_file, what="json"):
            json_file.write_text(text, encoding="utf-8")
    if out is not None:
        with writing(out, what="out"):
            write_run(out, config, result)
    return EXIT_FELL if result.summary["fell"] else EXIT_STANDING


def _config_and_events(
    arguments: argparse.Namespace,
) -> tuple[RunConfig, tuple[CommandEvent, ...]]:
    """Return the settings and the events that the arguments describe."""
    given: Path | None = arguments.events
    if given is None or not given.is_dir():
        return config_from(arguments), () if given is None else read_events(given)
    if arguments.config is not None:
        raise ConfigError(
            f"events: expected --events alone, got --config too; {given} has the run's settings"
        )
    settings = given / "config.toml"
    if not settings.is_file():
        raise ConfigError(
            f"events: expected the folder of a run, got {given} without a config.toml; try a "
            "folder that ./deploy/up or trial --out wrote"
        )
    arguments.config = settings
    config = config_from(arguments)
    played = _task_seconds(given)
    if played is not None and arguments.duration is None:
        config = dataclasses.replace(config, duration=played)
    file = given / EVENTS_FILE
    return config, read_events(file) if file.exists() else ()


def _task_seconds(run: Path) -> float | None:
    """Return how long the task of a run lasted [s]; None if that is unknown, or it never began."""
    try:
        summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
        return float(summary["task_seconds"]) or None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _check_free(out: Path | None, json_file: Path | None, *, force: bool) -> None:
    """Raise a `ConfigError` if files of another run would be replaced without --force."""
    if force:
        return
    if out is not None and out.is_dir() and any(out.iterdir()):
        raise ConfigError(
            f"out: expected a new or empty folder, got {out} with files; try another, or --force"
        )
    if json_file is not None and json_file.is_file():
        raise ConfigError(
            f"json: expected a new file, got {json_file}, which exists; try another, or --force"
        )


def write_run(out: Path, config: RunConfig, result: TrialResult) -> None:
    """Write the files of a run that `deploy/up` writes, without logs and recording."""
    out.mkdir(parents=True, exist_ok=True)
    text = dump_config(config, versions=result.summary["versions"])
    (out / "config.toml").write_text(text, encoding="utf-8")
    text = json.dumps(result.summary, indent=2) + "\n"
    (out / "summary.json").write_text(text, encoding="utf-8")
    write_parquet(result.schema, result.rows, out / "telemetry.parquet")
    write_parquet(LINK_SCHEMA, result.link_rows, out / "link.parquet")
    write_parquet(SOLVE_SCHEMA, result.solve_rows, out / "edge.parquet")
    if config.stepping.mode != "off":
        write_parquet(STEP_SCHEMA, result.step_rows, out / "steps.parquet")
    if result.events:
        write_events(out / EVENTS_FILE, result.events)
