"""Reproducible trials under simulated time, and their results."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

_STUDIES = "experiments.studies"
_REPRODUCTION = "experiments.reproduction"
COMMANDS = (
    Subcommand("trial", "play one trial and print its summary", "experiments.trial"),
    Subcommand("link", "try each controller over a whole link", "experiments.link"),
    Subcommand("sweep", "play a study and print its table", f"{_STUDIES}.sweep"),
    Subcommand(
        "run",
        "play and print the paper's tables and figures",
        f"{_REPRODUCTION}.run",
        "reproduction",
    ),
    Subcommand("report", "write a page of the results of `run`", f"{_REPRODUCTION}.report"),
    Subcommand("check", "play trials of a finished sweep again", f"{_STUDIES}.check"),
    Subcommand("atlas", "draw a map of falls over delay and push", "experiments.atlas"),
    Subcommand("figure", "draw the results of a sweep", "experiments.figure"),
    Subcommand(
        "corrections",
        "measure the limits of a stale factorisation at random states",
        f"{_STUDIES}.corrections",
    ),
    Subcommand("new", "make a package for a controller, task, robot or plant", "experiments.new"),
    Subcommand("config", "print the settings of a run", "experiments.resolved"),
    Subcommand(
        "settings",
        "write the tables of all settings into docs/configuration.md",
        "experiments.settings_page",
    ),
)

ROBOT_COMMANDS = (
    Subcommand(
        "check",
        "check a robot file and play trials with it",
        "experiments.robot_check",
        "robot_check",
    ),
)

PLANT_COMMANDS = (
    Subcommand(
        "check", "check the conventions of a plant", "experiments.plant_check", "plant_check"
    ),
)


def main() -> int:
    return run_command(__doc__, COMMANDS)


if __name__ == "__main__":
    run(main)
