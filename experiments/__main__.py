"""Reproducible runs under simulated time, and what they come to."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from experiments.atlas import add_atlas_arguments, run_atlas
from experiments.figure import add_figure_arguments, run_figure
from experiments.reproduction.report import add_report_arguments, run_report
from experiments.reproduction.run import add_run_arguments, run_reproduction
from experiments.settings_page import add_settings_arguments, run_settings
from experiments.studies.check import add_check_arguments, run_check
from experiments.studies.corrections import add_corrections_arguments, run_corrections
from experiments.studies.sweep import add_sweep_arguments, run_sweep
from experiments.trial import add_trial_arguments, run_trial
from shared.process.cli import Subcommand, run, run_command

_COMMANDS = (
    Subcommand("trial", "play one run and print its summary", add_trial_arguments, run_trial),
    Subcommand("sweep", "play a study and print its table", add_sweep_arguments, run_sweep),
    Subcommand("run", "the paper's tables and figures", add_run_arguments, run_reproduction),
    Subcommand("report", "a page of what `run` has found", add_report_arguments, run_report),
    Subcommand("check", "play trials of a finished sweep again", add_check_arguments, run_check),
    Subcommand("atlas", "how often a robot falls: delay × push", add_atlas_arguments, run_atlas),
    Subcommand("figure", "draw what a sweep has found", add_figure_arguments, run_figure),
    Subcommand(
        "corrections",
        "how far a factorisation may be from the state, without simulating",
        add_corrections_arguments,
        run_corrections,
    ),
    Subcommand("settings", "the tables of all settings", add_settings_arguments, run_settings),
)


def main() -> int:
    return run_command("experiments", __doc__, _COMMANDS)


if __name__ == "__main__":
    run(main)
