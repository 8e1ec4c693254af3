"""The emulated link as a process: `python -m netem --listen tcp/… --connect tcp/… --profile NAME`.

The robot dials `--listen`, the shim dials the edge at `--connect`. Key expressions are the same on
both sides: taking the shim out is a change of one endpoint.
"""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
from netem.profile import DOWNLINK as DOWN
from netem.profile import UPLINK as UP
from netem.profile import load_profile
from netem.shim import Shim, Sides
from shared.bus.zenoh_bus import ZenohBus, machine_clock
from shared.cli import EXIT_STANDING, Parser, add_run_arguments, config_from, run
from shared.errors import ConfigError
from shared.realtime import prepare, suspend_garbage_collection
from shared.report import link_report
from shared.service import (
    EDGE_ENDPOINT,
    NETEM_ENDPOINT,
    ServiceLog,
    StopSignal,
    add_service_arguments,
)
from shared.telemetry import LINK_SCHEMA
from shared.wire.channels import DOWNLINK, LINK_KEY, UPLINK

_PRIORITY = 20


def main() -> int:
    parser = Parser(prog="netem", description=__doc__)
    parser.add_argument(
        "--listen",
        metavar="ENDPOINT",
        default=NETEM_ENDPOINT,
        help="robot side (default %(default)s)",
    )
    parser.add_argument(
        "--connect",
        metavar="ENDPOINT",
        default=EDGE_ENDPOINT,
        help="edge side (default %(default)s)",
    )
    parser.add_argument("--profile", dest="network", help="the same as --network")
    add_service_arguments(parser)
    add_run_arguments(parser)
    arguments = parser.parse_args()
    config = config_from(arguments)
    if config.link.network == "direct":
        raise ConfigError("network: direct means no shim at all; the robot dials the edge itself")
    profile = load_profile(config.link.network)
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    near = ZenohBus(listen=[arguments.listen])
    far = ZenohBus(connect=[arguments.connect])
    log = ServiceLog(
        "link", LINK_SCHEMA, out=arguments.out, telemetry=arguments.telemetry, key=LINK_KEY
    )
    robot = config.robot.name
    sides = Sides(
        uplink=far.publisher(UPLINK.key_for(robot), wait_when_full=True),
        downlink=near.publisher(DOWNLINK.key_for(robot), wait_when_full=True),
    )
    shim = Shim(
        profile,
        config.link,
        seed=config.seed,
        sides=sides,
        log=log.rows,
        clock=machine_clock(),
        say=lambda text: print(text, flush=True),
    )
    near.subscribe(UPLINK.key_for(robot), shim.receive(UP))
    far.subscribe(DOWNLINK.key_for(robot), shim.receive(DOWN))
    suspend_garbage_collection()
    print(
        f"READY {arguments.listen} → {arguments.connect} ({scheduling}; {profile.name}, nominal "
        f"round trip {profile.nominal_round_trip_ns * 1e-6:.2f} ms)",
        flush=True,
    )
    shim.run(lambda: stop.requested)
    near.close()
    far.close()
    log.finish(lambda rows: link_report(rows, profile=profile.name, passes=shim.passes))
    print(f"stopped: {sides.uplink.sent} up, {sides.downlink.sent} down", flush=True)
    return EXIT_STANDING


if __name__ == "__main__":
    run(main)
