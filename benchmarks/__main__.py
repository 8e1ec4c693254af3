"""Speed and exactness on this machine."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

COMMANDS = (
    Subcommand("capacity", "recorded delays given back", "benchmarks.commands"),
    Subcommand("core", "where the time goes; or ratios to another commit", "benchmarks.commands"),
    Subcommand("faults", "faults on purpose, and the promises", "benchmarks.faults.campaign"),
    Subcommand("floor", "what no Python can beat", "benchmarks.commands"),
    Subcommand("limits", "what the robot's own limits cost a tick", "benchmarks.commands"),
    Subcommand("lockstep", "speed of a trial", "benchmarks.commands"),
    Subcommand("netem", "how exactly the link is emulated", "benchmarks.commands"),
    Subcommand("peers", "beside TSID and placo, in ratios", "benchmarks.commands"),
    Subcommand("recording", "recorded against replayed delays", "benchmarks.commands"),
    Subcommand(
        "real-path", "two namespaces and a slow cable, as root", "benchmarks.real_path.measure"
    ),
    Subcommand("session", "random commands to a live stack", "benchmarks.commands"),
    Subcommand("viewer", "whether watching disturbs the robot", "benchmarks.commands"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS, group="bench")


if __name__ == "__main__":
    run(main)
