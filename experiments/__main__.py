"""Reproducible runs under simulated time, and what they come to."""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
from experiments.corrections import add_corrections_arguments, run_corrections
from experiments.figure import add_figure_arguments, run_figure
from experiments.sweep import add_sweep_arguments, run_sweep
from experiments.trial import add_trial_arguments, run_trial
from shared.cli import Parser, run


def main() -> int:
    parser = Parser(prog="experiments", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, told, add_arguments, run_command in (
        ("trial", "play one run and print its summary", add_trial_arguments, run_trial),
        ("sweep", "play a study and print its table", add_sweep_arguments, run_sweep),
        ("figure", "draw what a sweep has found", add_figure_arguments, run_figure),
        (
            "corrections",
            "how far a factorisation may be from the state, without simulating",
            add_corrections_arguments,
            run_corrections,
        ),
    ):
        command = commands.add_parser(name, help=told)
        add_arguments(command)
        command.set_defaults(run_command=run_command)
    arguments = parser.parse_args()
    code: int = arguments.run_command(arguments)
    return code


if __name__ == "__main__":
    run(main)
