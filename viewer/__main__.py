"""Watch a run as it happens, look at it again, compare it with others, make pictures of it."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

COMMANDS = (
    Subcommand("live", "show a run as it happens", "viewer.commands"),
    Subcommand("open", "show a run that is over", "viewer.commands"),
    Subcommand("compare", "show runs side by side, their lines together", "viewer.commands"),
    Subcommand("snapshot", "make a picture or an animation", "viewer.commands"),
    Subcommand("record", "build RUN/recording.rrd", "viewer.commands"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS, group="viewer")


if __name__ == "__main__":
    run(main)
