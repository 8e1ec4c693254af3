"""`python -m viewer live` shows a run as it happens; `python -m viewer record` one that is over."""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
import argparse
import os
import sys
import time
from pathlib import Path

from shared.cli import EXIT_STANDING, Parser, run
from shared.config_file import load_config
from shared.service import StopSignal
from viewer.display import VIEWS
from viewer.live import watch
from viewer.recording import record


def main() -> int:
    parser = Parser(prog="viewer", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    live = commands.add_parser("live", help="show a run as it happens")
    live.add_argument("--config", metavar="FILE.toml", required=True, help="settings of the run")
    live.add_argument(
        "--telemetry", metavar="ENDPOINT", required=True, help="hub, as in tcp/127.0.0.1:7450"
    )
    live.add_argument("--view", choices=VIEWS, default="native", help="(default %(default)s)")
    live.add_argument("--out", metavar="DIR", type=Path, help="also write DIR/recording.rrd")
    over = commands.add_parser("record", help="build RUN_DIR/recording.rrd of a finished run")
    over.add_argument("run", metavar="RUN_DIR", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "live":
        _live(arguments)
    else:
        _record(arguments)
    return EXIT_STANDING


def _live(arguments: argparse.Namespace) -> None:
    stop = StopSignal()
    watch(
        load_config(arguments.config),
        telemetry=arguments.telemetry,
        view=arguments.view,
        out=arguments.out,
        stopped=lambda: stop.requested,
        say=lambda line: print(line, flush=True),
    )


def _record(arguments: argparse.Namespace) -> None:
    began = time.monotonic()
    recorded = record(arguments.run)
    print(
        f"{recorded.path}: {recorded.rows} rows in {recorded.size_bytes / 1e6:.1f} MB, "
        f"made in {time.monotonic() - began:.1f} s; open it with: rerun {recorded.path}"
    )


if __name__ == "__main__":
    try:
        run(main)
    except SystemExit as ending:
        sys.stdout.flush()
        # Everything is closed; on a busy machine, unloading the libraries would take seconds more.
        os._exit(ending.code if isinstance(ending.code, int) else 1)
