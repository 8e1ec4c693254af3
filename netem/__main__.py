"""The emulated link: profiles of delay, and the shim that replays them."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from netem.convert import add_convert_arguments, run_convert
from netem.generator.calibration import add_calibrate_arguments, run_calibrate
from netem.generator.generate import add_generate_arguments, run_generate
from netem.inspect import (
    add_list_arguments,
    add_show_arguments,
    add_stats_arguments,
    run_list,
    run_show,
    run_stats,
)
from netem.packets import add_packets_arguments, run_packets
from netem.recorder.record import add_record_arguments, run_record
from netem.replay import add_replay_arguments, run_replay
from shared.process.cli import Subcommand, run, run_command

_COMMANDS = (
    Subcommand("list", "shipped profiles and what they are like", add_list_arguments, run_list),
    Subcommand("show", "one profile, as text or as a picture", add_show_arguments, run_show),
    Subcommand("stats", "delays and outages of a profile", add_stats_arguments, run_stats),
    Subcommand("generate", "profiles of a modelled 5G link", add_generate_arguments, run_generate),
    Subcommand("calibrate", "the model beside ns-3", add_calibrate_arguments, run_calibrate),
    Subcommand("record", "measure a real path as a profile", add_record_arguments, run_record),
    Subcommand("convert", "a foreign measurement as a profile", add_convert_arguments, run_convert),
    Subcommand("replay", "stand between robot and edge", add_replay_arguments, run_replay),
    Subcommand("packets", "be the link, packet by packet", add_packets_arguments, run_packets),
)


def main() -> int:
    return run_command("netem", __doc__, _COMMANDS)


if __name__ == "__main__":
    run(main)
