"""Check a plant: its members, conventions of frames and signs, contact forces."""

from __future__ import annotations

import argparse
from functools import partial

from robot_node.plant import make_plant
from robot_node.plant_checks import plant_faults
from shared.process.cli import EXIT_STANDING
from shared.process.entry import EXIT_ERROR
from shared.process.run_options import add_run_arguments, config_from
from shared.robots import load_robot


def add_plant_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `plant check`: those of a run, of which it uses robot and plant."""
    add_run_arguments(parser)


def run_plant_check(arguments: argparse.Namespace) -> int:
    """Print a line for each check. Return 0 if all pass, otherwise 2."""
    config = config_from(arguments)
    robot = load_robot(config.robot.name)
    timestep = config.loop.period_ns * 1e-9
    make = partial(make_plant, robot, config.plant, timestep=timestep)
    found = plant_faults(make, robot, timestep=timestep)
    for name, faults in found.items():
        print(f"{'FAIL' if faults else 'ok':4}  {name}", *faults, sep="\n      ")
    return EXIT_ERROR if any(found.values()) else EXIT_STANDING
