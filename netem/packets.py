"""The emulated link below the transport: `python -m netem packets factory/003`, as root.

Makes two network namespaces and moves every IP packet from one to the other as the profile has it.
Whatever is started in them (`ip netns exec …`) has this link between its ends, with the fragments,
retransmissions and queues of its own transport; `docs/packet-level.md` tells when that matters.
"""

from __future__ import annotations

import argparse
import dataclasses

from netem.delay_line import make_lines
from netem.networks import load_network
from netem.packet_pump import Way, pump, wait_for_packet
from netem.profile import DIRECTIONS
from netem.tun import MAX_MTU, MIN_MTU, End, NamespacePair
from shared.cli import EXIT_STANDING, add_run_arguments, config_from
from shared.config import RunConfig
from shared.errors import ConfigError
from shared.realtime import prepare, suspend_garbage_collection
from shared.service import StopSignal

# Before the nodes: a packet that waits to be read waits in no profile.
_PRIORITY = 40
_PORT = 7460


def add_packets_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `packets`."""
    parser.add_argument("profile", nargs="?", metavar="NETWORK", help="the same as --network")
    parser.add_argument(
        "--robot-ns", metavar="NAME", default="wbc-robot", help="(default %(default)s)"
    )
    parser.add_argument(
        "--edge-ns", metavar="NAME", default="wbc-edge", help="(default %(default)s)"
    )
    parser.add_argument(
        "--mtu",
        metavar="BYTES",
        type=int,
        default=1500,
        help="largest packet (default %(default)s); a larger one means fewer packets to move",
    )
    add_run_arguments(parser)


def run_packets(arguments: argparse.Namespace) -> int:
    """Be the link until a signal; 0."""
    config = _config(arguments)
    profile = load_network(config.link.network)
    stop = StopSignal()
    pair = NamespacePair(robot=arguments.robot_ns, edge=arguments.edge_ns, mtu=arguments.mtu)
    with pair as (robot, edge):
        scheduling = prepare(priority=_PRIORITY)
        suspend_garbage_collection()
        print(
            f"READY robot {robot.address} ↔ edge {edge.address}, MTU {arguments.mtu} "
            f"({scheduling}; {profile.name}, nominal round trip "
            f"{profile.nominal_round_trip_ns * 1e-6:.2f} ms)"
        )
        endpoint = f"tcp/{edge.address}:{_PORT}"
        print(f"  edge:  ip netns exec {edge.namespace} python -m edge_node --listen {endpoint}")
        print(
            f"  robot: ip netns exec {robot.namespace} python -m robot_node --connect {endpoint}",
            flush=True,
        )
        ways = _move(config, robot, edge, packet_bytes=arguments.mtu, stop=stop)
        missed = pair.dropped()
    for name, way, unread in zip(DIRECTIONS, ways, missed, strict=False):
        print(_summary(name, way, unread))
    return EXIT_STANDING


def _config(arguments: argparse.Namespace) -> RunConfig:
    if arguments.profile is not None:
        if arguments.network is not None:
            raise ConfigError(
                f"network: expected once, got {arguments.profile!r} and {arguments.network!r}"
            )
        arguments.network = arguments.profile
    if not MIN_MTU <= arguments.mtu <= MAX_MTU:
        raise ConfigError(f"--mtu: expected {MIN_MTU} to {MAX_MTU}, got {arguments.mtu}")
    if arguments.robot_ns == arguments.edge_ns:
        raise ConfigError(f"--edge-ns: expected another name than --robot-ns, {arguments.edge_ns}")
    config = config_from(arguments)
    if config.link.network == "direct":
        raise ConfigError("network: direct means no link to emulate; try constant:0ms")
    # Least sizes are those of messages.
    link = dataclasses.replace(config.link, uplink_bytes=0, downlink_bytes=0)
    return dataclasses.replace(config, link=link)


def _move(
    config: RunConfig, robot: End, edge: End, *, packet_bytes: int, stop: StopSignal
) -> list[Way]:
    """Move packets until a signal; the profile begins with the first one."""
    profile = load_network(config.link.network)
    start_ns = wait_for_packet((robot.descriptor, edge.descriptor), stopping=lambda: stop.requested)
    lines = make_lines(profile, config.link, seed=config.seed, start_ns=start_ns)
    offset = profile.start_offset_ns(config.seed) * 1e-9
    print(f"replaying {profile.name} from {offset:.3f} s", flush=True)
    ways = [
        Way(
            line,
            source=source.descriptor,
            target=target.descriptor,
            queue_bytes=config.link.queue_bytes,
            packet_bytes=packet_bytes,
        )
        for line, source, target in zip(lines, (robot, edge), (edge, robot), strict=True)
    ]
    pump(ways, stopping=lambda: stop.requested)
    return ways


def _summary(name: str, way: Way, unread: int) -> str:
    late = way.lateness
    return (
        f"{name}: {way.packets} packets, {way.bytes * 1e-6:.1f} MB; lost {way.line.lost} by the "
        f"profile, {way.full} in a full queue, {way.refused} at the far end, {unread} unread; late "
        f"p50 {late.quantile_ms(0.5):.2f} ms, p99 {late.quantile_ms(0.99):.2f} ms, max "
        f"{late.max_ns * 1e-6:.2f} ms"
    )
