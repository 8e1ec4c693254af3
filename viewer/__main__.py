"""Watch a live run, look at finished runs, compare them, make pictures of them."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

COMMANDS = (
    Subcommand("live", "show a run as it happens", "viewer.commands"),
    Subcommand("open", "show a finished run", "viewer.commands"),
    Subcommand("compare", "show runs side by side, and their lines in one plot", "viewer.commands"),
    Subcommand("snapshot", "make a picture or an animation", "viewer.commands"),
    Subcommand("record", "build RUN/recording.rrd", "viewer.commands"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS, group="viewer")


if __name__ == "__main__":
    run(main)
