"""Benchmarks of speed and accuracy on this machine."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

COMMANDS = (
    Subcommand(
        "capacity", "accuracy of the delays that a derived capacity gives", "benchmarks.commands"
    ),
    Subcommand(
        "core", "time of each part of a tick; or ratios to another commit", "benchmarks.commands"
    ),
    Subcommand(
        "edges", "two robots on one edge, or two edges of which one dies", "benchmarks.commands"
    ),
    Subcommand(
        "faults", "play faults and check the promises about them", "benchmarks.faults.campaign"
    ),
    Subcommand("flood", "effect of a flood of commands on the robot", "benchmarks.commands"),
    Subcommand("floor", "lower bound of the time of a tick in Python", "benchmarks.commands"),
    Subcommand("limits", "cost of the robot's own limits in a tick", "benchmarks.commands"),
    Subcommand("lockstep", "speed of a trial", "benchmarks.commands"),
    Subcommand("netem", "accuracy of the emulated link", "benchmarks.commands"),
    Subcommand("peers", "times of a step as ratios to TSID and placo", "benchmarks.commands"),
    Subcommand("recording", "difference of recorded and replayed delays", "benchmarks.commands"),
    Subcommand(
        "real-path",
        "robot and edge in two namespaces on a slow cable, as root",
        "benchmarks.real_path.measure",
    ),
    Subcommand("session", "random commands to a live stack", "benchmarks.commands"),
    Subcommand("viewer", "effect of a viewer on the robot", "benchmarks.commands"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS, group="bench")


if __name__ == "__main__":
    run(main)
