"""Every importer against damaged files: a profile, or one line that says what is wrong."""

from __future__ import annotations

import gzip
import re

import numpy as np
import pytest

from netem.profile import LOST
from shared.errors import UserError
from tests.netem.importers.conftest import SAMPLES, run

PING = """PING 10.6.1.6 (10.6.1.6) 56(84) bytes of data.
64 bytes from 10.6.1.6: icmp_seq=1 ttl=64 time=24.3 ms
64 bytes from 10.6.1.6: icmp_seq=2 ttl=64 time=21.8 ms
From 10.6.1.1 icmp_seq=3 Destination Host Unreachable
64 bytes from 10.6.1.6: icmp_seq=4 ttl=64 time=20.9 ms

--- 10.6.1.6 ping statistics ---
5 packets transmitted, 3 received, +1 errors, 40% packet loss, time 4005ms
rtt min/avg/max/mdev = 20.900/22.333/24.300/1.438 ms
"""
NR = """time(s)\tcellId\trnti\tlcid\tpacketSize\tdelay(s)
0.401\t1\t1\t4\t1030\t0.0005
0.402\t1\t1\t4\t1030\t0.0006
0.4031\t1\t1\t4\t1030\t0.0007
"""
WINDOWS = """
Pinging host.example [192.0.2.7] with 32 bytes of data:
Reply from 192.0.2.7: bytes=32 time=87ms TTL=51
Request timed out.
Reply from 192.0.2.7: bytes=32 time<1ms TTL=51

Ping statistics for 192.0.2.7:
    Packets: Sent = 3, Received = 2, Lost = 1 (33% loss),
"""
FPING = """[1700000000.10000] 192.0.2.7 : [0], 64 bytes, 12.3 ms (12.3 avg, 0% loss)
[1700000000.20000] 192.0.2.7 : [1], timed out (NaN avg, 50% loss)
[1700000000.30000] 192.0.2.7 : [2], 64 bytes, 11.3 ms (11.8 avg, 33% loss)
"""
HEADLESS = """Tx 0.1 1 1 3 100
Rx 0.1005 1 1 3 100 500000
Tx 0.101 1 1 3 100
Rx 0.1015 1 1 3 100 500000
"""
DATES = """Device: X

date time;rtt_ms
2023-11-14 22:13:20.00;20
2023-11-14 22:13:20.01;nan
2023-11-14 22:13:20.02;21
"""
FLENT = """{"metadata": {}, "x_values": [], "raw_values": {"Ping (ms) ICMP": [
{"seq": 1.0, "t": 1436735904.39, "val": 50.1}, {"seq": 3.0, "t": 1436735904.6, "val": 49.7}]}}
"""
NETEM = "# a table\n -16384 -8192 -4096 0\n 0 4096 8192 16384\n"
HISTOGRAM = """<histogram>
    <bin low="-inf ms">0</bin>
    <bin low="3.971072ms">1</bin>
    <bin low="4.009026ms">4</bin>
    <bin low="4.04698ms">0</bin>
</histogram>
"""
TABLE = """pub_time(ms) sub_time(ms) delay(ms) sinr(db)
1721808645768 1721808645787 19 7
1721808645823 1721808646092 269 7
1721808645884 1721808646092 208 7
1721808645943 1721808646092 149 7
"""
QUOTED = '"t (s)";"delay (ms)"\n0,5;20,25\n0,6;"21,5"\n0,7;lost\n0,8;22\n'
LOAD = ("--load", "1500B@1kHz")
# For each case: places where the file is cut, files with damaged bytes (a quarter for each kind of
# damage), and numbers that are replaced.
N_CUTS, N_DAMAGED, N_REPLACED = 20, 16, 2
DRAWN = ("--duration", "50ms")


def text_of(name):
    return (SAMPLES / name).read_bytes()


# The damaged file goes in the first place; what follows is whole.
CASES = {
    "ns3 per packet": (text_of("UlPdcpStats_perpacket.txt"), ["--other-way", "same"]),
    "ns3 downlink": (
        text_of("DlPdcpStats_perpacket.txt"),
        ["--other-way", "same", "--phy", SAMPLES / "RxPacketTrace.txt"],
    ),
    "ns3 rlc": (text_of("UlRlcStats_perpacket.txt"), ["--other-way", "same"]),
    "ns3 epochs": (text_of("DlPdcpStats_aggregated.txt"), ["--other-way", "same"]),
    "ns3 nr": (NR.encode(), ["--other-way", "same"]),
    "irtt": (text_of("irtt_sample.json"), []),
    "irtt halves": (text_of("irtt_sample.json"), ["--clock", "half"]),
    "ping -D": (text_of("ping_D_sample.txt"), []),
    "ping": (PING.encode(), ["--interval", "10ms"]),
    "mahimahi": (b"1\n1\n2\n5\n5\n5\n9\n", ["--other-way", "same", *LOAD]),
    "cellreplay": (b"0 20 0 0 1\n100 25 0 1 3\n200 22 0 4 5\n", ["--other-way", "same"]),
    "netem": (NETEM.encode(), ["--delay", "10ms", "--jitter", "2ms", *DRAWN]),
    "histogram": (HISTOGRAM.encode(), ["--other-way", "same", *DRAWN]),
    "table": (TABLE.encode(), ["--other-way", "same"]),
    "table of quotes": (
        QUOTED.encode(),
        ["--columns", "sent=t (s),delay=delay (ms)", "--other-way", "same"],
    ),
    "ping of Windows": (WINDOWS.encode(), ["--interval", "10ms"]),
    "fping": (FPING.encode(), []),
    "ns3 headless": (HEADLESS.encode(), ["--other-way", "same"]),
    "table of dates": (DATES.encode(), ["--columns", "sent=date time,rtt=rtt_ms"]),
    "flent": (FLENT.encode(), []),
    "pcap": (text_of("s1u_gnb_gtpu.pcap"), [SAMPLES / "sgi_remotehost_dl.pcap"]),
    "pcapng": (text_of("near.pcapng"), [SAMPLES / "far.pcapng", "--other-way", "same"]),
    "gzip": (gzip.compress(PING.encode(), mtime=0), ["--interval", "10ms"]),
}
BINARY = ("pcap", "pcapng", "gzip")
FORCED = {
    "flent": "flent",
    "ns3": "ns3 per packet",
    "irtt": "irtt",
    "ping": "ping",
    "mahimahi": "mahimahi",
    "cellreplay": "cellreplay",
    "netem": "netem",
    "histogram": "histogram",
    "table": "table",
}


def outcome(tmp_path, content, rest, *more):
    """The profile, or the message, of which there is one line that names the file."""
    path = tmp_path / "damaged"
    path.write_bytes(content)
    try:
        profile = run(tmp_path / "out.npz", path, *rest, *more)
    except UserError as error:
        message = str(error)
    else:
        assert profile.delays_ns.min() >= LOST
        return profile
    assert "\n" not in message
    assert "damaged" in message
    assert len(message) < 1000
    return message


@pytest.mark.parametrize("case", CASES)
def test_the_whole_file_is_a_profile(case, tmp_path):
    assert not isinstance(outcome(tmp_path, *CASES[case]), str)


@pytest.mark.parametrize("case", CASES)
def test_a_file_cut_anywhere_is_a_profile_or_an_error_of_one_line(case, tmp_path):
    content, rest = CASES[case]
    ends = np.unique(np.linspace(0, len(content) - 1, N_CUTS).astype(int))
    refused = [isinstance(outcome(tmp_path, content[:end], rest), str) for end in ends]
    assert refused[0]


@pytest.mark.parametrize("case", CASES)
def test_damaged_bytes_make_a_profile_or_an_error_of_one_line(case, tmp_path, rng):
    content, rest = CASES[case]
    for number in range(N_DAMAGED):
        damaged = bytearray(content)
        at, length = int(rng.integers(len(content))), int(rng.integers(1, 40))
        junk = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        kind = number % 4
        if kind == 0:
            damaged[at : at + length] = junk
        elif kind == 1:
            del damaged[at : at + length]
        elif kind == 2:
            damaged[at] ^= 1 << int(rng.integers(8))
        else:
            damaged[at:at] = b"9" * length
        outcome(tmp_path, bytes(damaged), rest)


@pytest.mark.parametrize("case", [case for case in CASES if case not in BINARY])
@pytest.mark.parametrize(
    "junk", ["nan", "inf", "-5", "1e300", "9" * 30, "", "x", "0x10", "1_000", "٣", "\0", "1e18"]
)
def test_a_number_that_is_none_makes_a_profile_or_an_error_of_one_line(case, junk, tmp_path, rng):
    content, rest = CASES[case]
    text = content.decode()
    numbers = list(re.finditer(r"[0-9][0-9.e+-]*", text))
    for k in rng.permutation(len(numbers))[:N_REPLACED]:
        start, end = numbers[k].span()
        outcome(tmp_path, (text[:start] + junk + text[end:]).encode(), rest)


@pytest.mark.parametrize("case", ["ns3 per packet", "ns3 epochs", "ns3 nr", "table"])
def test_a_row_without_one_of_its_columns_is_named_with_its_line(case, tmp_path):
    content, rest = CASES[case]
    lines = content.decode().splitlines()
    mark = "\t" if "\t" in lines[-1] else " "
    lines[-1] = mark.join(lines[-1].split(mark)[1:])
    message = outcome(tmp_path, "\n".join(lines).encode(), rest)
    assert f"line {len(lines)}: expected" in message
    assert "columns" in message


@pytest.mark.parametrize("case", ["ns3 per packet", "ns3 epochs", "ns3 nr", "table"])
def test_a_table_without_a_column_is_a_profile_or_an_error_of_one_line(case, tmp_path):
    content, rest = CASES[case]
    lines = content.decode().splitlines()
    mark = "\t" if "\t" in lines[-1] else " "
    for column in range(len(lines[0].split(mark))):
        rows = [line.split(mark) for line in lines]
        cut = [mark.join(row[:column] + row[column + 1 :]) for row in rows]
        outcome(tmp_path, "\n".join(cut).encode(), rest)


@pytest.mark.parametrize("name", FORCED)
@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"\n\n\n", b"\0" * 1000, b"\xff\xfe\xff", bytes(range(256)) * 40, b"hello world\n"),
        *(b"{}", b'{"round_trips": []}', b'{"round_trips": [1, "a", null]}', b"[" * 100_000),
        *(
            b"1 2 3\n" * 5,
            b"-1\n0\n",
            b"PAR1" + bytes(100),
            b"\x1f\x8b\x08" + bytes(40),
            b"\r" * 50,
        ),
    ],
)
def test_a_file_of_something_else_is_refused_in_one_line(name, content, tmp_path):
    rest = CASES[FORCED[name]][1]
    outcome(tmp_path, content, rest, "--format", name)
    outcome(tmp_path, content, rest)


@pytest.mark.parametrize("name", FORCED)
def test_every_sample_under_every_format_is_refused_in_one_line_or_read(name, tmp_path):
    rest = CASES[FORCED[name]][1]
    for content, _ in CASES.values():
        outcome(tmp_path, content, rest, "--format", name)
