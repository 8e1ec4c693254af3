from __future__ import annotations

import struct
from typing import Any

import pytest

from netem.profile import DOWNLINK, LOST, UPLINK

MS = 1_000_000
ROBOT, EDGE = bytes([10, 0, 0, 1]), bytes([10, 0, 0, 2])
OTHER = ("--other-way", "same")
MAGICS = {("<", 1000): 0xA1B2C3D4, ("<", 1): 0xA1B23C4D}


def udp(payload, checksum=0):
    return struct.pack(">4H", 5000, 6000, 8 + len(payload), checksum) + payload


def ip(body, *, identity, source=ROBOT, destination=EDGE, offset=0, more=False, protocol=17):
    fragment = offset // 8 | (0x2000 if more else 0)
    header = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), identity, fragment, 64, protocol, 0)
    return header + source + destination + body


def ip6(body, *, source=ROBOT * 4, destination=EDGE * 4, protocol=17):
    return struct.pack(">IHBB", 6 << 28, len(body), protocol, 64) + source + destination + body


def gtp(packet, *, flags=0x30, between=b""):
    body = struct.pack(">BBHI", flags, 0xFF, len(between) + len(packet), 1) + between + packet
    outer = struct.pack(">4H", 2152, 2152, 8 + len(body), 0) + body
    return ip(outer, identity=0, source=bytes([172, 16, 0, 1]), destination=bytes([172, 16, 0, 2]))


def pcap(packets, *, order="<", unit_ns=1000, link=101):
    """A capture of (time_ns, bytes)."""
    data = struct.pack(order + "IHHIIII", 0xA1B2C3D4 if unit_ns == 1000 else 0xA1B23C4D,
                       2, 4, 0, 0, 262144, link)  # fmt: skip
    for time_ns, packet in packets:
        seconds, rest = divmod(time_ns, 10**9)
        data += struct.pack(order + "4I", seconds, rest // unit_ns, len(packet), len(packet))
        data += packet
    return data


def messages(count, *, delay_ns, start_ns=10**9, direction=UPLINK, lost=(), wrap=lambda p: p):
    """Captures near the robot and near the edge of a message a ms, the k-th delayed k µs more."""
    ends = (ROBOT, EDGE) if direction == UPLINK else (EDGE, ROBOT)
    sent, received = [], []
    for k in range(count):
        packet = wrap(ip(udp(struct.pack(">I", k) * 20), identity=k % 65536, source=ends[0],
                         destination=ends[1]))  # fmt: skip
        sent.append((start_ns + k * MS, packet))
        if k not in lost:
            received.append((start_ns + k * MS + delay_ns + k * 1000, packet))
    return (sent, received) if direction == UPLINK else (received, sent)


def records(path):
    """(time_ns, bytes) of a little-endian µs capture, by the book."""
    data = path.read_bytes()
    at = 24
    while at < len(data):
        seconds, micros, length, _ = struct.unpack("<4I", data[at : at + 16])
        yield seconds * 10**9 + micros * 1000, data[at + 16 : at + 16 + length]
        at += 16 + length


def test_a_datagram_has_arrived_with_its_last_fragment(convert, sample):
    robot_side, edge_side = sample("s1u_gnb_gtpu.pcap"), sample("sgi_remotehost_dl.pcap")
    profile = convert(robot_side, edge_side)
    # PPP (2 bytes), and at the base station IP (20), UDP (8) and GTP (12) around the packet.
    sent: dict[tuple[bytes, int], int] = {}
    arrived: dict[tuple[bytes, int], int] = {}
    for records_of, skipped, times, pick in (
        (records(edge_side), 2, sent, min),
        (records(robot_side), 42, arrived, max),
    ):
        for time_ns, frame in records_of:
            packet = frame[skipped:]
            key = (packet[12:16], int.from_bytes(packet[4:6], "big"))
            times[key] = pick(times.get(key, time_ns), time_ns)
    down, up = bytes([1, 0, 0, 2]), bytes([7, 0, 0, 2])
    # One message up was seen at both ends, and down the one sent after that.
    assert profile.delays_ns[UPLINK].tolist() == [sent[up, 0] - arrived[up, 0]]
    assert profile.delays_ns[DOWNLINK].tolist() == [arrived[down, 1] - sent[down, 1]]
    assert profile.metadata["flows"] == {
        "uplink": ["7.0.0.2 > 1.0.0.2"],
        "downlink": ["1.0.0.2 > 7.0.0.2"],
    }
    assert profile.metadata["uplink_bytes"] == 1000
    assert profile.metadata["downlink_bytes"] == 40000


@pytest.mark.parametrize("direction", [UPLINK, DOWNLINK])
def test_the_way_is_told_by_where_a_packet_was_seen_first(convert, written, direction):
    near, far = messages(20, delay_ns=5 * MS, direction=direction)
    files = written("near.pcap", pcap(near)), written("far.pcap", pcap(far))
    profile = convert(*files, "--other-way", "constant:1ms")
    assert profile.delays_ns[direction].tolist() == [5 * MS + k * 1000 for k in range(20)]
    assert set(profile.delays_ns[1 - direction].tolist()) == {MS}
    size = profile.metadata[f"{('uplink', 'downlink')[direction]}_bytes"]
    assert size == 80


ETHERNET = bytes(12)
LINKS = {
    "raw": (101, lambda p: p),
    "raw BSD": (12, lambda p: p),
    "loopback": (0, lambda p: struct.pack("<I", 2) + p),
    "Ethernet": (1, lambda p: ETHERNET + b"\x08\x00" + p),
    "Ethernet padded": (1, lambda p: ETHERNET + b"\x08\x00" + p + bytes(18)),
    "VLAN": (1, lambda p: ETHERNET + b"\x81\x00\x00\x05\x08\x00" + p),
    "two VLANs": (1, lambda p: ETHERNET + b"\x88\xa8\x00\x05\x81\x00\x00\x06\x08\x00" + p),
    "PPP": (9, lambda p: b"\x00\x21" + p),
    "PPP in HDLC": (9, lambda p: b"\xff\x03\x00\x21" + p),
    "cooked": (113, lambda p: bytes(14) + b"\x08\x00" + p),
    "cooked 2": (276, lambda p: b"\x08\x00" + bytes(18) + p),
}
TUNNELS = {
    "plain": gtp,
    "sequence": lambda p: gtp(p, flags=0x32, between=b"\x00\x07\x00\x00"),
    "extension": lambda p: gtp(p, flags=0x34, between=b"\x00\x00\x00\x85\x01\x10\x09\x00"),
    "extensions": lambda p: gtp(
        p,
        flags=0x36,
        between=b"\x00\x07\x00\x85" + b"\x02" + bytes(6) + b"\x85" + b"\x01\x10\x09\x00",
    ),
}


@pytest.mark.parametrize("unit_ns", [1, 1000])
@pytest.mark.parametrize("order", ["<", ">"])
def test_captures_of_either_byte_order_and_either_unit_are_read(convert, written, order, unit_ns):
    near, far = messages(5, delay_ns=2 * MS)
    files = written("a.pcap", pcap(near, order=order, unit_ns=unit_ns)), written("b", pcap(far))
    profile = convert(*files, "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS + k * 1000 for k in range(5)]


@pytest.mark.parametrize("link", LINKS)
def test_the_link_under_ip_does_not_matter(convert, written, link):
    near, far = messages(5, delay_ns=2 * MS)
    number, wrap = LINKS[link]
    wrapped = pcap([(t, wrap(p)) for t, p in far], link=number)
    profile = convert(written("a", pcap(near)), written("b", wrapped), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS + k * 1000 for k in range(5)]


@pytest.mark.parametrize("tunnel", TUNNELS)
def test_packets_in_a_tunnel_are_taken_out_of_it(convert, written, tunnel):
    near, far = messages(5, delay_ns=2 * MS)
    inside = pcap([(t, TUNNELS[tunnel](p)) for t, p in far])
    profile = convert(written("a", pcap(near)), written("b", inside), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS + k * 1000 for k in range(5)]


def test_ip_version_6_is_understood_with_and_without_fragments(convert, written):
    near, far = [], []
    for k in range(6):
        body = udp(struct.pack(">I", k) * 10)
        plain = [ip6(body)]
        parts = [
            ip6(struct.pack(">BBHI", 17, 0, 1, k) + body[:24], protocol=44),
            ip6(struct.pack(">BBHI", 17, 0, 24, k) + body[24:], protocol=44),
        ]
        for j, packet in enumerate(parts if k % 2 else plain):
            near.append((10**9 + k * MS, packet))
            far.append((10**9 + k * MS + (2 + j) * MS, packet))
    far.sort(key=lambda record: record[0])
    profile = convert(written("a", pcap(near)), written("b", pcap(far)), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS, 3 * MS] * 3


def test_a_packet_missing_at_the_other_end_is_lost_and_one_fragment_loses_its_datagram(
    convert, written
):
    near, far = [], []
    for k in range(10):
        body = udp(bytes([k]) * 92)
        for part, offset in enumerate((0, 48, 96)):
            packet = ip(body[offset : offset + 48], identity=k, offset=offset, more=offset < 96)
            near.append((10**9 + k * MS + part * 1000, packet))
            if not (k == 4 and part == 1) and k != 6:
                far.append((10**9 + k * MS + part * 5000 + 3 * MS, packet))
    far.sort(key=lambda record: record[0])
    profile = convert(written("a", pcap(near)), written("b", pcap(far)), "--other-way", "same")
    expected = [LOST if k in (4, 6) else 3 * MS + 10_000 for k in range(10)]
    assert profile.delays_ns[UPLINK].tolist() == expected
    assert profile.metadata["uplink_bytes"] == 92


def test_a_checksum_that_the_network_card_fills_in_does_not_matter(convert, written):
    near = [(10**9 + k * MS, ip(udp(bytes([k] * 30)), identity=k)) for k in range(5)]
    far = [(t + MS, ip(udp(bytes([k] * 30), 0xBEEF), identity=k)) for k, (t, _) in enumerate(near)]
    profile = convert(written("a", pcap(near)), written("b", pcap(far)), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [MS] * 5


def test_identifications_are_used_again_and_losses_do_not_shift_them(convert, written):
    # The same few packets every 40 s; one of the first round is lost.
    near, far = [], []
    for cycle in range(2):
        for k in range(4):
            packet = ip(udp(bytes(40)), identity=k)
            near.append((10**9 + cycle * 40 * 10**9 + k * MS, packet))
            if (cycle, k) != (0, 2):
                far.append((near[-1][0] + 2 * MS, packet))
    files = written("a", pcap(near)), written("b", pcap(far))
    profile = convert(*files, "--other-way", "same", "--pause", "cut")
    assert profile.delays_ns[UPLINK, :4].tolist() == [2 * MS, 2 * MS, LOST, 2 * MS]
    assert profile.delays_ns.max() == 2 * MS


def both_ways(shift_ns):
    """Captures of both ways, the edge's clock ahead by that."""
    up_near, up_far = messages(20, delay_ns=5 * MS)
    down_near, down_far = messages(20, delay_ns=7 * MS, direction=DOWNLINK)
    near = sorted(up_near + down_near)
    far = sorted((t + shift_ns, p) for t, p in up_far + down_far)
    return pcap(near), pcap(far)


def test_clocks_that_differ_are_found_out_and_made_one(convert, refused, written):
    near, far = (written(n, data) for n, data in zip("ab", both_ways(50 * MS), strict=True))
    text = refused(near, far)
    assert "--robot" in text
    assert "--clock offset" in text
    assert (
        "expected downlink delays of 0 or more, got negative ones, down to -43.000 ms"
        in refused(near, far, "--robot", "10.0.0.1")
    )
    profile = convert(near, far, "--robot", "10.0.0.1", "--clock", "offset")
    # The sum of both is right; the shortest are taken to be equal, (5 + 7) / 2. The difference of
    # the clocks is a millisecond short by that, and so is the downlink's first time of sending.
    assert profile.delays_ns[UPLINK].tolist() == [6 * MS + k * 1000 for k in range(1, 20)]
    assert profile.delays_ns[DOWNLINK].tolist() == [6 * MS + k * 1000 for k in range(19)]


def test_clocks_that_agree_are_left_alone(convert, written):
    near, far = (written(n, data) for n, data in zip("ab", both_ways(0), strict=True))
    profile = convert(near, far)
    assert profile.delays_ns[UPLINK].tolist() == [5 * MS + k * 1000 for k in range(20)]
    assert profile.delays_ns[DOWNLINK].tolist() == [7 * MS + k * 1000 for k in range(20)]


def test_what_was_sent_before_the_other_capture_began_is_not_lost(convert, written):
    near, far = messages(10, delay_ns=2 * MS)
    files = written("a", pcap(near)), written("b", pcap(far[4:]))
    profile = convert(*files, "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS + k * 1000 for k in range(4, 10)]


def test_a_datagram_cut_off_by_the_end_of_its_capture_is_left_out(convert, written):
    near, far = [], []
    for k in range(5):
        for part in range(3):
            packet = ip(bytes([k] * 48), identity=k, offset=48 * part, more=part < 2)
            near.append((10**9 + k * MS, packet))
            far.append((10**9 + k * MS + (part + 1) * 100_000, packet))
    files = written("a", pcap(near[:-1])), written("b", pcap(far))
    assert convert(*files, "--other-way", "same").delays_ns[UPLINK].tolist() == [300_000] * 4


def test_captures_of_different_packets_are_refused(refused, written):
    near, _ = messages(5, delay_ns=MS)
    other, _ = messages(5, delay_ns=MS, start_ns=100 * 10**9)
    files = written("a.pcap", pcap(near)), written("b.pcap", pcap(other))
    assert "got none in 5 and 5" in refused(*files)


def test_a_capture_alone_is_refused(refused, sample):
    assert "expected two" in refused(sample("s1u_gnb_gtpu.pcap"))


def block(order, kind, body):
    body += bytes(-len(body) % 4)
    length = struct.pack(order + "I", 12 + len(body))
    return struct.pack(order + "I", kind) + length + body + length


def pcapng(packets, *, order="<", options=b"", per_second=10**6, offset_s=0, link=101):
    """A section, two interfaces, of which the second one is used, and a block of another kind."""
    data = block(order, 0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    data += block(order, 1, struct.pack(order + "HHI", 147, 0, 0))
    data += block(order, 1, struct.pack(order + "HHI", link, 0, 0) + options)
    data += block(order, 5, bytes(12))
    for time_ns, packet in packets:
        ticks = (time_ns - offset_s * 10**9) * per_second // 10**9
        head = struct.pack(order + "5I", 1, ticks >> 32, ticks & 0xFFFFFFFF, *[len(packet)] * 2)
        data += block(order, 6, head + packet)
    return data


PCAPNG: dict[str, dict[str, Any]] = {
    "plain": {},
    "big-endian": {"order": ">"},
    "ns": {"options": b"\x09\x00\x01\x00\x09\0\0\0" + bytes(4), "per_second": 10**9},
    "binary": {"options": b"\x09\x00\x01\x00\x94\0\0\0", "per_second": 2**20},
    "offset": {
        "options": b"\x02\x00\x03\x00eth\0" + b"\x0e\x00\x08\x00" + struct.pack("<q", -5),
        "offset_s": -5,
    },
}


@pytest.mark.parametrize("kind", PCAPNG)
def test_pcapng_is_read_as_wireshark_writes_it(convert, written, kind):
    near, far = messages(20, delay_ns=5 * MS)
    files = written("a.pcapng", pcapng(near, **PCAPNG[kind])), written("b.pcap", pcap(far))
    profile = convert(*files, "--other-way", "same")
    # 2⁻²⁰ s are a microsecond, nearly.
    error = abs(profile.delays_ns[UPLINK] - [5 * MS + k * 1000 for k in range(20)])
    assert error.max() <= (1000 if kind == "binary" else 0)


def test_sections_of_pcapng_follow_one_another(convert, written):
    near, far = messages(20, delay_ns=5 * MS)
    both = pcapng(near[:10]) + pcapng(near[10:], order=">")
    files = written("a.pcapng", both), written("b.pcapng", pcapng(far))
    profile = convert(*files, "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [5 * MS + k * 1000 for k in range(20)]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: data[:-6], "block 9 at byte"),
        (lambda data: data[:30], "block 2 at byte 28: expected 8 bytes"),
        (lambda data: data[:8] + bytes(4) + data[12:], "the byte order of a section"),
        (lambda data: data[:4] + b"\x1d" + data[5:], "block 1 at byte 0: expected a length"),
        (lambda data: data[:36] + b"\x93\0" + data[38:56] + b"\x93\0" + data[58:], "link type"),
        (lambda data: data + block("<", 3, bytes(8)), "frames with times"),
    ],
    ids=["cut", "header cut", "order", "length", "link", "no times"],
)
def test_damaged_pcapng_is_named_with_its_block(refused, written, damage, words):
    near, far = messages(5, delay_ns=MS)
    text = refused(written("a.pcapng", damage(pcapng(near))), written("b.pcap", pcap(far)))
    assert "a.pcapng" in text
    assert words in text


def rtps(k):
    """A datagram without an identification, of which the first 40 bytes are always the same."""
    return ip(udp(b"RTPS" + bytes(36) + struct.pack(">I", k) + bytes(40)), identity=0)


def test_packets_are_told_apart_by_all_that_both_captures_hold(convert, written):
    near = [(10**9 + k * MS, rtps(k)) for k in range(500)]
    far = [(t + 3 * MS, packet) for k, (t, packet) in enumerate(near) if k != 100]
    files = written("a", pcap(near)), written("b", pcap(far))
    profile = convert(*files, "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [LOST if k == 100 else 3 * MS for k in range(500)]


def cut_short(data, length, snap):
    """A capture whose packets of `length` bytes are cut after `snap`."""
    short = data[:24]
    for at in range(24, len(data), 16 + length):
        head = data[at : at + 8] + struct.pack("<2I", snap, length)
        short += head + data[at + 16 : at + 16 + snap]
    return short


def test_a_capture_that_is_cut_short_is_compared_as_far_as_it_goes(convert, written):
    near = [(10**9 + k * MS, rtps(k)) for k in range(50)]
    far = pcap([(t + 3 * MS, packet) for k, (t, packet) in enumerate(near) if k != 7])
    short = cut_short(pcap(near), len(rtps(0)), 20 + 8 + 44)
    profile = convert(written("near.pcap", short), written("b", far), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [LOST if k == 7 else 3 * MS for k in range(50)]
    note = "near.pcap: packets cut short, so that the first 52 bytes of payloads are compared"
    assert note in profile.metadata["notes"]


def test_packets_that_are_all_alike_are_refused_if_one_is_missing(convert, refused, written):
    near = [(10**9 + k * MS, rtps(k)) for k in range(50)]
    far = [(t + 3 * MS, packet) for t, packet in near]
    short = written("near.pcap", cut_short(pcap(near), len(rtps(0)), 60))
    profile = convert(short, written("b", pcap(far)), "--other-way", "same")
    assert set(profile.delays_ns[UPLINK].tolist()) == {3 * MS}
    text = refused(short, written("b", pcap(far[:7] + far[8:])), "--other-way", "same")
    for words in ("50 and 49 equal packets 10.0.0.1 > 10.0.0.2", "first 40 bytes", "-s 0"):
        assert words in text


def test_a_clock_that_is_set_during_a_capture_is_told(convert, written):
    near, far = messages(20, delay_ns=5 * MS)
    near = [(t - 2 * MS * (k > 9), packet) for k, (t, packet) in enumerate(near)]
    profile = convert(written("a", pcap(near)), written("b", pcap(far)), "--other-way", "same")
    assert any(note.startswith("a: times step back 1 times") for note in profile.metadata["notes"])


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: data[:30], "record 1 at byte 24: expected 16 bytes"),
        (lambda data: data[:-7], "record 5 at byte"),
        (lambda data: data[:20] + b"\x93\0\0\0" + data[24:], "link type"),
        (lambda data: data[:32] + b"\xff\xff\xff\x7f" + data[36:], "record 1 at byte 24"),
    ],
    ids=["header cut", "packet cut", "link", "length"],
)
def test_a_damaged_capture_is_named_with_its_record(refused, written, damage, words):
    near, far = messages(5, delay_ns=MS)
    text = refused(written("a.pcap", damage(pcap(near))), written("b.pcap", pcap(far)))
    assert "a.pcap" in text
    assert words in text


# Captures that differ by how they were made ------------------------------------------------------


def segment(number, payload, *, identity, ports=(40000, 22)):
    tcp = struct.pack(">HHIIBBHHH", *ports, number, 0, 0x50, 0x18, 1000, 0, 0)
    return ip(tcp + payload, identity=identity, protocol=6)


def test_a_connection_that_the_other_capture_leaves_out_is_not_lost(convert, written):
    near, far = messages(20, delay_ns=5 * MS, lost=(7,))
    shell = [
        (10**9 + k * MS + 500_000, segment(k, b"y" * 9, identity=k + 500)) for k in range(1, 15)
    ]
    mixed = sorted(near + shell)
    profile = convert(written("n.pcap", pcap(mixed)), written("f.pcap", pcap(far)), *OTHER)
    assert profile.metadata["packets_lost"]["uplink"] == 1
    assert (
        "uplink: left out 14 packets of TCP 10.0.0.1:40000 > 10.0.0.2:22, of which the other "
        "capture has none (its filter?)"
    ) in profile.metadata["notes"]
    # A few packets may be lost by chance.
    few = sorted(near + shell[:3])
    profile = convert(written("n.pcap", pcap(few)), written("f.pcap", pcap(far)), *OTHER)
    assert not any("left out" in note for note in profile.metadata["notes"])


@pytest.mark.parametrize("joined_at", ["sender", "receiver"])
def test_packets_that_a_network_card_cuts_or_joins_are_refused(refused, written, joined_at):
    whole = [(10**9 + k * MS, segment(2800 * k, b"y" * 2800, identity=2 * k)) for k in range(9)]
    parts = [
        (10**9 + k * MS + j, segment(2800 * k + 1400 * j, b"y" * 1400, identity=2 * k + j))
        for k in range(9)
        for j in range(2)
    ]
    acks = messages(9, delay_ns=MS)
    near, far = (whole, parts) if joined_at == "sender" else (parts, whole)
    far = [(t + 5 * MS, packet) for t, packet in far]
    text = refused(
        written("n.pcap", pcap(sorted(near + acks[0]))),
        written("f.pcap", pcap(sorted(far + acks[1]))),
        *OTHER,
    )
    name = "n.pcap" if joined_at == "sender" else "f.pcap"
    assert f"{name}: expected packets as they are on the wire, got one of 2820 bytes" in text
    assert "gro off" in text


def test_one_capture_for_both_ends_is_refused(refused, written):
    near, _ = messages(5, delay_ns=MS)
    file = written("n.pcap", pcap(near))
    assert "expected captures of two ends, got each packet at the same time" in refused(file, file)


def test_a_capture_that_was_stopped_is_refused_with_the_remedy(refused, written):
    near, far = messages(5, delay_ns=MS)
    text = refused(written("n.pcap", pcap(near)[:-9]), written("f.pcap", pcap(far)), *OTHER)
    assert "n.pcap, record 5" in text
    assert "try editcap IN OUT" in text


def test_the_way_of_a_single_flow_is_told(convert, written):
    near, far = messages(5, delay_ns=MS)
    files = written("n.pcap", pcap(near)), written("f.pcap", pcap(far))
    words = "uplink: 10.0.0.1 > 10.0.0.2, because n.pcap saw these packets first; --robot ADDRESS"
    assert any(words in note for note in convert(*files, *OTHER).metadata["notes"])
    profile = convert(*files, *OTHER, "--robot", "10.0.0.1")
    assert not any("saw these packets" in note for note in profile.metadata["notes"])
