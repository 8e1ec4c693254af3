"""Reproducible runs under simulated time, and what they come to."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

_STUDIES = "experiments.studies"
_REPRODUCTION = "experiments.reproduction"
COMMANDS = (
    Subcommand("trial", "play one run and print its summary", "experiments.trial"),
    Subcommand("link", "try each controller over a whole link", "experiments.link"),
    Subcommand("sweep", "play a study and print its table", f"{_STUDIES}.sweep"),
    Subcommand("run", "the paper's tables and figures", f"{_REPRODUCTION}.run", "reproduction"),
    Subcommand("report", "a page of what `run` has found", f"{_REPRODUCTION}.report"),
    Subcommand("check", "play trials of a finished sweep again", f"{_STUDIES}.check"),
    Subcommand("atlas", "how often a robot falls: delay × push", "experiments.atlas"),
    Subcommand("figure", "draw what a sweep has found", "experiments.figure"),
    Subcommand(
        "corrections",
        "how far a factorisation may be from the state, without simulating",
        f"{_STUDIES}.corrections",
    ),
    Subcommand("settings", "the tables of all settings", "experiments.settings_page"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS)


if __name__ == "__main__":
    run(main)
