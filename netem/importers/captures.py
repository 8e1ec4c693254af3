"""One-way delays from two captures of the same packets, one at either end of the link.

Addresses, protocol, IP identification, fragment offset, length and payload identify a packet. Of
each payload the importer compares the bytes that both captures hold. A sender uses an
identification again after a while, so two captures of one packet may be at most 30 s apart. If
several packets within that time are the same in all of this, they are paired in order. If one of
them is missing, the captures do not show which, and the importer refuses them. A datagram arrives
with its last fragment, and is lost if any fragment is lost. Addresses must be the same at both
ends. A translation of addresses between the ends hides every packet.

A capture may have left out a connection (addresses, protocol and ports) by its filter. The importer
leaves out a connection of which the receiver's capture has no packet while it has packets of
others. A network card that cuts or joins packets (offload) makes them differ, which is refused.
"""

from __future__ import annotations

import ipaddress
import itertools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from netem.importers.measured import (
    Measured,
    Way,
    ordered,
    stepped_back_note,
    unfinished_note,
    without_unfinished,
)
from netem.importers.options import Options
from netem.importers.pcap import WHOLE, Packet, held_of_each, packets
from netem.profile import DIRECTIONS, DOWNLINK, UPLINK
from shared.errors import ConfigError, ProfileError

_APART_NS = 30_000_000_000
_SAME_DATAGRAM_NS = 1_000_000_000
_MAX_PACKETS = 5_000_000
_UDP, _UDP_HEADER = 17, 8
_PROTOCOLS = {1: "ICMP", 6: "TCP", _UDP: "UDP", 58: "ICMPv6"}
# A connection with fewer packets may be lost by chance.
_FEW = 10
# No packet on a usual Ethernet has more bytes of IP's payload.
_LONGEST = 1480
_Flow = tuple[bytes, bytes]
_Connection = tuple[_Flow, int, bytes]


@dataclass
class _Datagram:
    """A datagram at its sender. It arrives with the last of its fragments, if none is lost."""

    connection: _Connection
    sent_ns: int
    arrived_ns: int
    lost: bool
    payload_bytes: int
    last: bool


def read_captures(robot_side: Path, edge_side: Path, options: Options) -> Measured:
    """The measurement of both directions, or of the one direction of which both captures have
    packets.
    """
    held = {path: held_of_each(path) for path in (robot_side, edge_side)}
    compared = min(held.values())
    near, far = (_read(path, compared) for path in (robot_side, edge_side))
    near_partner, far_partner = _matched(near, far, f"{robot_side}, {edge_side}", compared)
    shifts: dict[_Flow, list[int]] = defaultdict(list)
    for packet, partner in zip(near, near_partner, strict=True):
        if partner is not None:
            shifts[packet.flow].append(partner.time_ns - packet.time_ns)
    _refuse_offload(near, near_partner, far, robot_side)
    _refuse_offload(far, far_partner, near, edge_side)
    if not shifts:
        raise ProfileError(
            f"{robot_side}, {edge_side}: expected the same packets in both, at most 30 s apart, "
            f"got none in {len(near)} and {len(far)}, {_in_bytes(compared)} compared; capture "
            "where no address is translated in between"
        )
    if len(near) > 1 and not any(shift for each in shifts.values() for shift in each):
        raise ProfileError(
            f"{robot_side}, {edge_side}: expected captures of two ends, got each packet at the "
            "same time in both; give the capture of the other end"
        )
    directions = _directions(shifts, options.robot, f"{robot_side}, {edge_side}")
    ways: list[Way | None] = [None, None]
    notes = [
        f"{path.name}: packets cut short, so that {_in_bytes(n)} are compared"
        for path, n in held.items()
        if n < WHOLE
    ]
    for side, path in ((near, robot_side), (far, edge_side)):
        times = np.array([packet.time_ns for packet in side])
        notes += [f"{path.name}: {note}" for note in stepped_back_note(times)]
    for direction, sender, partners, receiver in (
        (UPLINK, near, near_partner, far),
        (DOWNLINK, far, far_partner, near),
    ):
        flows = {flow for flow, way in directions.items() if way == direction}
        if flows:
            datagrams, left_out = _without_filtered(_datagrams(sender, partners, flows), receiver)
            notes += [f"{DIRECTIONS[direction]}: {note}" for note in left_out]
            ways[direction], unfinished = _way(datagrams, receiver[-1].time_ns)
            notes += unfinished_note(unfinished)
    one = UPLINK if ways[DOWNLINK] is None else DOWNLINK
    if ways[1 - one] is None and options.robot is None:
        seen = (robot_side, edge_side)[one].name
        notes.append(
            f"{DIRECTIONS[one]}: {', '.join(_in_words(directions, one))}, because {seen} saw these "
            "packets first; --robot ADDRESS says otherwise"
        )
    described = {DIRECTIONS[way]: _in_words(directions, way) for way in (UPLINK, DOWNLINK)}
    return Measured((ways[0], ways[1]), tuple(notes), {"flows": described}, two_clocks=True)


def _read(path: Path, compared: int) -> list[Packet]:
    read = []
    for packet in packets(path, compared=compared):
        read.append(packet)
        if len(read) > _MAX_PACKETS:
            raise ProfileError(
                f"{path}: expected at most {_MAX_PACKETS} IP packets, got more; cut it, as by "
                "editcap -i 60"
            )
    if not read:
        raise ProfileError(f"{path}: expected IP packets, got none; capture the link's interface")
    return read


def _matched(
    near: list[Packet], far: list[Packet], files: str, compared: int
) -> tuple[list[Packet | None], list[Packet | None]]:
    """The same packet in the other capture, for each packet of either; None without one."""
    of_near: list[Packet | None] = [None] * len(near)
    of_far: list[Packet | None] = [None] * len(far)
    places: dict[bytes, tuple[list[int], list[int]]] = defaultdict(lambda: ([], []))
    for side, of_side in enumerate((near, far)):
        for index, packet in enumerate(of_side):
            places[packet.key][side].append(index)
    for here, there in places.values():
        alike = _repeated(near, here) or _repeated(far, there)
        if alike and there and here and len(here) != len(there):
            flow = " > ".join(str(ipaddress.ip_address(end)) for end in near[here[0]].flow)
            raise ProfileError(
                f"{files}: expected different packets, or equal numbers of them in both, got "
                f"{len(here)} and {len(there)} equal packets {flow} ({_in_bytes(compared)} "
                "compared); capture whole packets (-s 0) on one interface each, or leave out that "
                "flow"
            )
        pairs = zip(here, there, strict=False) if alike else _in_turn(near, here, far, there)
        for mine, other in pairs:
            of_near[mine], of_far[other] = far[other], near[mine]
    return of_near, of_far


def _repeated(side: list[Packet], places: list[int]) -> bool:
    """Return whether two of the packets are too close in time to tell their captures apart."""
    times = [side[place].time_ns for place in places]
    return any(after - before <= _APART_NS for before, after in itertools.pairwise(times))


def _in_turn(
    near: list[Packet], here: list[int], far: list[Packet], there: list[int]
) -> Iterator[tuple[int, int]]:
    """Pairs of captures that are close enough in time."""
    k = 0
    for mine in here:
        time = near[mine].time_ns
        while k < len(there) and far[there[k]].time_ns < time - _APART_NS:
            k += 1
        if k < len(there) and far[there[k]].time_ns <= time + _APART_NS:
            yield mine, there[k]
            k += 1


def _in_bytes(compared: int) -> str:
    """The compared part of a payload, in words."""
    return "whole payloads" if compared >= WHOLE else f"the first {compared} bytes of payloads"


def _directions(shifts: dict[_Flow, list[int]], robot: str | None, files: str) -> dict[_Flow, int]:
    """The direction of each flow, by the robot's address or by the capture that saw it first."""
    if robot is not None:
        try:
            address = ipaddress.ip_address(robot).packed
        except ValueError:
            raise ConfigError(f"robot: expected its IP address, got {robot!r}") from None
        flows = {flow: flow[0] == address for flow in shifts if address in flow}
        if not flows:
            raise ProfileError(
                f"{files}: expected packets of {robot} in both, got none; give --robot the robot's "
                "address in the captures"
            )
        return {flow: UPLINK if up else DOWNLINK for flow, up in flows.items()}
    directions = {
        flow: UPLINK if np.median(shift) >= 0 else DOWNLINK for flow, shift in shifts.items()
    }
    for (source, destination), way in directions.items():
        if directions.get((destination, source)) == way and source != destination:
            raise ProfileError(
                f"{files}: expected answers to go the other way, got packets and answers that go "
                f"{DIRECTIONS[way]}, because the clocks of the two ends differ; try --robot "
                "ADDRESS and --clock offset"
            )
    return directions


def _refuse_offload(
    side: list[Packet], partners: list[Packet | None], other: list[Packet], path: Path
) -> None:
    """Raise `ProfileError` if this capture has packets that the other one has in parts."""
    longest: dict[_Flow, int] = defaultdict(int)
    for packet in other:
        longest[packet.flow] = max(longest[packet.flow], packet.payload_bytes)
    for packet, partner in zip(side, partners, strict=True):
        there = longest[packet.flow]
        if partner is None and there and packet.payload_bytes > max(_LONGEST, there):
            raise ProfileError(
                f"{path}: expected packets as they are on the wire, got one of "
                f"{packet.payload_bytes} bytes where the other capture has at most {there}, "
                "because a network card cuts or joins packets; capture after ethtool -K INTERFACE "
                "tso off gso off gro off lro off"
            )


def _datagrams(
    sender: list[Packet], partners: list[Packet | None], flows: set[_Flow]
) -> list[_Datagram]:
    """The datagrams that the sender's capture has in these flows, with all their fragments."""
    datagrams: list[_Datagram] = []
    open_ones: dict[bytes, _Datagram] = {}
    for packet, partner in zip(sender, partners, strict=True):
        if packet.flow not in flows:
            continue
        arrived_ns = packet.time_ns if partner is None else partner.time_ns
        size, lost = packet.payload_bytes, partner is None
        one = open_ones.get(packet.datagram)
        if one is None or packet.time_ns - one.sent_ns > _SAME_DATAGRAM_NS:
            size -= _UDP_HEADER if packet.protocol == _UDP else 0
            connection = (packet.flow, packet.protocol, packet.ports)
            one = _Datagram(connection, packet.time_ns, arrived_ns, lost, size, packet.last)
            datagrams.append(one)
            open_ones[packet.datagram] = one
        else:
            one.arrived_ns = max(one.arrived_ns, arrived_ns)
            one.lost |= lost
            one.payload_bytes += size
            one.last |= packet.last
        if packet.last:
            open_ones.pop(packet.datagram, None)
    return datagrams


def _without_filtered(
    datagrams: list[_Datagram], receiver: list[Packet]
) -> tuple[list[_Datagram], list[str]]:
    """Leave out the connections that the receiver's capture does not have. Return notes too."""
    there = {(packet.flow, packet.protocol, packet.ports) for packet in receiver}
    arrived_ns = np.array([one.sent_ns for one in datagrams if not one.lost])
    absent: dict[_Connection, list[int]] = defaultdict(list)
    for one in datagrams:
        if one.connection not in there:
            absent[one.connection].append(one.sent_ns)
    filtered = {
        connection: times
        for connection, times in absent.items()
        if len(times) >= _FEW and np.diff(np.searchsorted(arrived_ns, [times[0], times[-1]])) > 0
    }
    notes = [
        f"left out {len(times)} packets of {_connection_in_words(connection)}, of which the other "
        "capture has none (its filter?)"
        for connection, times in filtered.items()
    ]
    return [one for one in datagrams if one.connection not in filtered], notes


def _way(datagrams: list[_Datagram], end_ns: int) -> tuple[Way, int]:
    # A datagram without its last fragment: the capture ended before the rest of it.
    known = [one for one in datagrams if one.last]
    # A datagram sent before the other capture began is not a loss.
    first = next((k for k, one in enumerate(known) if not one.lost), 0)
    known = known[first:]
    way = ordered(
        [one.sent_ns for one in known],
        [one.arrived_ns - one.sent_ns for one in known],
        [one.lost for one in known],
        message_bytes=int(np.median([one.payload_bytes for one in known])) if known else None,
    )
    return without_unfinished(way, end_ns)


def _connection_in_words(connection: _Connection) -> str:
    """The connection as in `TCP 10.0.0.1:40000 > 10.0.0.2:22`."""
    flow, protocol, ports = connection
    numbers = (int.from_bytes(ports[:2], "big"), int.from_bytes(ports[2:], "big"))
    ends = [
        f"{ipaddress.ip_address(end)}{f':{port}' if ports else ''}"
        for end, port in zip(flow, numbers, strict=True)
    ]
    return f"{_PROTOCOLS.get(protocol, f'protocol {protocol}')} {' > '.join(ends)}"


def _in_words(directions: dict[_Flow, int], way: int) -> list[str]:
    """The first flows of a direction, as in `10.0.0.1 > 10.0.0.2`."""
    flows = [flow for flow, direction in directions.items() if direction == way]
    return [" > ".join(str(ipaddress.ip_address(end)) for end in flow) for flow in flows[:8]]
