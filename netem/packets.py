"""Emulate the link below the transport: `./wbc netem packets factory/003`, as root.

Makes two network namespaces and moves every IP packet from one to the other with the profile's
delay. Programs started in them (`ip netns exec …`) have this link between them, with the fragments,
retransmissions and queues of their transport. `docs/packet-level.md` says when that matters.
"""

from __future__ import annotations

import argparse
import dataclasses

from netem.delay_line import make_lines
from netem.link_options import add_link_arguments, link_config_from
from netem.networks import load_network
from netem.packet_pump import Way, pump, wait_for_packet
from netem.profile import DIRECTIONS, Profile, begin_ns
from netem.tun import MAX_MTU, MIN_MTU, End, NamespacePair
from shared.commands import python_module
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.process.cli import EXIT_STANDING
from shared.process.realtime import prepare, suspend_garbage_collection
from shared.process.service import StopSignal

# Above the priority of the nodes: the profile does not count the time before a packet is read.
_PRIORITY = 40
_PORT = 7460


def add_packets_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `packets`."""
    parser.add_argument(
        "--robot-ns",
        metavar="NAME",
        default="wbc-robot",
        help="namespace of the robot (default %(default)s)",
    )
    parser.add_argument(
        "--edge-ns",
        metavar="NAME",
        default="wbc-edge",
        help="namespace of the edge (default %(default)s)",
    )
    parser.add_argument(
        "--mtu",
        metavar="BYTES",
        type=int,
        default=1500,
        help="largest packet (default %(default)s); larger packets are fewer packets to move",
    )
    add_link_arguments(parser)


def run_packets(arguments: argparse.Namespace) -> int:
    """Emulate the link until a signal arrives. Return 0."""
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
        for end, module, option in (
            (edge, "edge_node", "--listen"),
            (robot, "robot_node", "--connect"),
        ):
            command = python_module(module, f"{option} {endpoint}")
            name = f"{module.removesuffix('_node')}:"
            print(f"  {name:6} ip netns exec {end.namespace} {command}", flush=True)
        ways = _move(profile, config, (robot, edge), mtu=arguments.mtu, stop=stop)
        unread = pair.dropped()
    if not ways:
        print("no packet was sent")
    for name, way, count in zip(DIRECTIONS, ways, unread, strict=False):
        print(_summary(name, way, count))
    return EXIT_STANDING


def _config(arguments: argparse.Namespace) -> RunConfig:
    if not MIN_MTU <= arguments.mtu <= MAX_MTU:
        raise ConfigError(f"--mtu: expected {MIN_MTU} to {MAX_MTU}, got {arguments.mtu}")
    if arguments.robot_ns == arguments.edge_ns:
        raise ConfigError(
            f"--edge-ns: expected a name other than --robot-ns, got {arguments.edge_ns} for both"
        )
    config = link_config_from(arguments, direct="direct means no link to emulate; try constant:0ms")
    # The configured sizes are sizes of messages. A packet counts with its real size.
    link = dataclasses.replace(config.link, uplink_bytes=0, downlink_bytes=0)
    return dataclasses.replace(config, link=link)


def _move(
    profile: Profile, config: RunConfig, ends: tuple[End, End], *, mtu: int, stop: StopSignal
) -> list[Way]:
    """Move packets until a signal arrives. Return uplink and downlink, [] if no packet was sent.

    The profile begins with the first packet.
    """
    sources = [end.descriptor for end in ends]
    start_ns = wait_for_packet(sources, stopping=lambda: stop.requested)
    if start_ns is None:
        return []
    offset = begin_ns(profile, config.link, seed=config.seed) * 1e-9
    print(f"replaying {profile.name} from {offset:.3f} s", flush=True)
    lines = make_lines(profile, config.link, seed=config.seed, start_ns=start_ns)
    ways = [
        Way(
            line,
            source=source,
            target=target,
            queue_bytes=config.link.queue_bytes,
            packet_bytes=mtu,
        )
        for line, source, target in zip(lines, sources, reversed(sources), strict=True)
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
