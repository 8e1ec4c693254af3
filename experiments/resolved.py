"""Print the settings of a run as they are resolved: defaults, task, robot, file and flags."""

from __future__ import annotations

import argparse
import sys

import tomli_w

from shared.config.config_file import differing, load_config, settings_table
from shared.process.cli import EXIT_STANDING
from shared.process.run_options import add_run_arguments, config_from


def add_config_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `config`."""
    parser.description = (
        "Print the settings of a run as a settings file: the defaults, what the task and the robot "
        "change, then the file and the flags."
    )
    add_run_arguments(parser)
    parser.add_argument(
        "--changed", action="store_true", help="only what differs from the default run"
    )


def run_config(arguments: argparse.Namespace) -> int:
    """Print the settings. Return 0."""
    table = settings_table(config_from(arguments))
    if arguments.changed:
        table = differing(table, settings_table(load_config(None)))
    sys.stdout.write(tomli_w.dumps(table))
    return EXIT_STANDING
