"""Run the shim as a process: `./wbc netem replay factory/003 --listen … --connect …`.

The robot dials `--listen`. The shim dials the edge at `--connect`. Key expressions are the same on
both sides, so a run without the shim differs in one endpoint only.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from netem.link_options import add_link_arguments, link_config_from
from netem.networks import load_network, profile_of
from netem.profile import DOWNLINK as DOWN
from netem.profile import UPLINK as UP
from netem.profile import profile_report
from netem.shim import Shim, Sides
from shared.bus.operator import CommandServer, RobotTimes
from shared.bus.security import NETEM
from shared.bus.zenoh_bus import ZenohBus, machine_clock
from shared.errors import ConfigError
from shared.output.report import link_report
from shared.process.cli import EXIT_STANDING
from shared.process.realtime import prepare, suspend_garbage_collection, usable_cores, wakes_late_ns
from shared.process.service import (
    EDGE_ENDPOINT,
    NETEM_ENDPOINT,
    ServiceLog,
    StopSignal,
    add_service_arguments,
    identity_from,
    script_of,
    wait_while_held,
)
from shared.telemetry.schema import LINK_SCHEMA
from shared.wire.channels import DOWNLINK, LINK_KEY, PLANS, UPLINK
from shared.wire.operator.commands import Accepted, Command, LinkCommand
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import LINK_COMMANDS_KEY

_PRIORITY = 20
# With fewer cores, spinning takes time from robot and edge (`docs/timing.md`).
_SPINNING_CORES = 4
_MAX_SPIN_NS = 80_000


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `replay`."""
    parser.add_argument(
        "--listen",
        metavar="ENDPOINT",
        default=NETEM_ENDPOINT,
        help="endpoint for the robot (default %(default)s)",
    )
    parser.add_argument(
        "--connect",
        metavar="ENDPOINT",
        default=EDGE_ENDPOINT,
        help="endpoint of the edge (default %(default)s)",
    )
    add_service_arguments(parser)
    add_link_arguments(parser)


def _serve_commands(hub: ZenohBus, shim: Shim, script: Sequence[CommandEvent]) -> None:
    """Carry out an operator's commands and a script, in the time of the robot on the hub."""
    times = RobotTimes(
        hub,
        lambda text: print(text, flush=True),
        on_clock=lambda reading: shim.set_time(reading.origin),
    )

    def carry_out(command: Command) -> Accepted:
        if not isinstance(command, LinkCommand):
            raise ConfigError(
                f"{command}: expected a command for the link, got one for another service"
            )
        return times.carried_out(command, shim.change(command, profile_of(command)))

    CommandServer(hub, LINK_COMMANDS_KEY, carry_out)
    times.play(script, carry_out)


def run_replay(arguments: argparse.Namespace) -> int:
    """Delay messages between robot and edge until a signal arrives. Return 0."""
    config = link_config_from(
        arguments, direct="direct means no shim; let the robot dial the edge, or try constant:0ms"
    )
    profile = load_network(config.link.network)
    me = identity_from(arguments, role=NETEM, kind=config.robot.label)
    script = script_of(arguments, LinkCommand)
    wait_while_held(arguments)
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    late_ns = wakes_late_ns()
    spin_ns = min(late_ns, _MAX_SPIN_NS) if usable_cores() >= _SPINNING_CORES else 0
    near = ZenohBus(
        listen=[arguments.listen],
        largest=DOWNLINK.max_bytes,
        lease=config.loop.link_lease,
        credentials=me.credentials,
    )
    far = ZenohBus.dial(
        arguments.connect,
        within=config.loop.connect_timeout,
        largest=UPLINK.max_bytes,
        lease=config.loop.link_lease,
        credentials=me.credentials,
        stopping=lambda: stop.requested,
    )
    log = ServiceLog(
        "link", LINK_SCHEMA, out=arguments.out, telemetry=arguments.telemetry, key=LINK_KEY
    )
    robot = me.robot
    sides = Sides(
        uplink=far.publisher(UPLINK.key_for(robot), wait_when_full=True),
        downlink=near.publisher(DOWNLINK.key_for(robot), wait_when_full=True),
        plans=near.publisher(PLANS.key_for(robot), wait_when_full=True),
    )
    shim = Shim(
        profile,
        config.link,
        seed=config.seed,
        sides=sides,
        row=log.row,
        clock=machine_clock(),
        say=lambda text: print(text, flush=True),
        spin_ns=spin_ns,
    )
    near.subscribe(UPLINK.key_for(robot), shim.receive(UP))
    far.subscribe(DOWNLINK.key_for(robot), shim.receive(DOWN))
    far.subscribe(PLANS.key_for(robot), shim.receive(DOWN, plans=True))
    if log.hub is not None:
        _serve_commands(log.hub, shim, script)
    suspend_garbage_collection()
    print(
        f"READY {arguments.listen} → {arguments.connect} ({scheduling}; {profile.name}, nominal "
        f"round trip {profile.nominal_round_trip_ns * 1e-6:.2f} ms; wakes "
        f"{late_ns * 1e-3:.0f} µs late, {'spins them' if spin_ns else 'does not spin'})",
        flush=True,
    )
    shim.run(lambda: stop.requested)
    log.finish(
        lambda rows: link_report(
            rows,
            profile=profile_report(profile, config.link, seed=config.seed),
            passes=shim.passes,
        )
    )
    print(
        f"stopped: {sides.uplink.sent} up, {sides.downlink.sent} down, {shim.under_way} still "
        "under way",
        flush=True,
    )
    # Last, because a neighbour that is cut off makes it wait.
    near.close()
    far.close()
    return EXIT_STANDING
