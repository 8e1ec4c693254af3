"""The emulated link: profiles of delay, and the shim that replays them."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

COMMANDS = (
    Subcommand("list", "list the shipped profiles with their delays", "netem.inspect"),
    Subcommand("show", "show one profile, as text or as a picture", "netem.inspect"),
    Subcommand("stats", "print delays and outages of a profile", "netem.inspect"),
    Subcommand("generate", "generate profiles of a modelled 5G link", "netem.generator.generate"),
    Subcommand("calibrate", "compare the model with ns-3", "netem.generator.calibration"),
    Subcommand("record", "measure a real path as a profile", "netem.recorder.record"),
    Subcommand("convert", "convert a measurement to a profile", "netem.convert"),
    Subcommand("replay", "delay messages between robot and edge", "netem.replay"),
    Subcommand("packets", "delay IP packets between robot and edge", "netem.packets"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS, group="netem")


if __name__ == "__main__":
    run(main)
