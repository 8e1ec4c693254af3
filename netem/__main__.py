"""The emulated link: profiles of delay, and the shim that replays them."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

COMMANDS = (
    Subcommand("list", "shipped profiles and what they are like", "netem.inspect"),
    Subcommand("show", "one profile, as text or as a picture", "netem.inspect"),
    Subcommand("stats", "delays and outages of a profile", "netem.inspect"),
    Subcommand("generate", "profiles of a modelled 5G link", "netem.generator.generate"),
    Subcommand("calibrate", "the model beside ns-3", "netem.generator.calibration"),
    Subcommand("record", "measure a real path as a profile", "netem.recorder.record"),
    Subcommand("convert", "a foreign measurement as a profile", "netem.convert"),
    Subcommand("replay", "stand between robot and edge", "netem.replay"),
    Subcommand("packets", "be the link, packet by packet", "netem.packets"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS, group="netem")


if __name__ == "__main__":
    run(main)
