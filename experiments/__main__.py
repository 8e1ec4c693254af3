"""Reproducible runs under simulated time: `python -m experiments trial …` or `… sweep …`."""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
from experiments.sweep import add_sweep_arguments, run_sweep
from experiments.trial import add_trial_arguments, run_trial
from shared.cli import Parser, run


def main() -> int:
    parser = Parser(prog="experiments", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    trial = commands.add_parser("trial", help="play one run in lockstep and print its summary")
    add_trial_arguments(trial)
    sweep = commands.add_parser("sweep", help="play a study and print its table")
    add_sweep_arguments(sweep)
    arguments = parser.parse_args()
    return run_trial(arguments) if arguments.command == "trial" else run_sweep(arguments)


if __name__ == "__main__":
    run(main)
