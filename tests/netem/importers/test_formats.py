"""What a file is taken for, and what is said of one that is none of these."""

from __future__ import annotations

import gzip
import json

import pytest

from netem.importers.formats import format_of
from netem.importers.options import Options
from netem.profile import LOST, UPLINK

MS = 1_000_000


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04" + bytes(26) + b"xl/workbook.xml", "a workbook; try: save the sheet as CSV"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a workbook"),
        (b"PK\x03\x04" + bytes(26) + b"a.csv", "a zip archive; try: unpack it"),
        (b"SQLite format 3\0", "a database"),
        (b"#ROSBAG V2.0\n", "a rosbag"),
        (b"[192.0.2.7:2112] seq=0 rtt=20.1ms rd=9.5ms sd=10.6ms\n", "irtt client -o FILE.json"),
        (b"seq=0 rtt=201\xc2\xb5s rd=95\xc2\xb5s\n", "irtt's text"),
        (b'{"start": {"version": "iperf 3.9"}, "intervals": []}', "iperf's sums"),
        (b"Connecting to host 192.0.2.7, port 5201\n[  5] local\n", "iperf's sums"),
        (b"[ ID] Interval       Transfer\n[  3]  0.0- 1.0 sec\n", "iperf's sums"),
        (b"\n \n", "an empty file"),
        (b"\x93NUMPY\x01\x00v\x00", "a NumPy array; try: numpy.savetxt"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"<!DOCTYPE html>\n<html>\n", "a page of the web"),
        (
            b"22:13:20.123456 IP 192.0.2.1 > 192.0.2.7: ICMP echo request, id 1, seq 1, length 8\n",
            "tcpdump -w FILE.pcap",
        ),
        (b"traceroute to 192.0.2.7 (192.0.2.7), 30 hops max\n 1  a  0.3 ms\n", "the routes of mtr"),
        (
            b"Start: 2023\nHOST: robot     Loss%   Snt   Last\n  1.|-- a  0.0%\n",
            "the routes of mtr",
        ),
        (b"192.0.2.7 : 12.3 11.2 - 10.1\n", "fping's lists without times; try: fping -D -l"),
        (b'{"resp": {"host":"192.0.2.7","seq":0,"rtt":0.057}}\n', "fping's JSON"),
        (b"seq_no=0       delay=1.23 ms   (sync, err=0.5 ms)\n", "the log of owping"),
        (b"Flow>1 Seq>1 Src>192.0.2.1/9 txTime>22:13:20.1 rxTime>22:13:20.2\n", "the log of D-ITG"),
        (b"Unicast reply from 192.0.2.7 [AA:BB:CC:DD:EE:FF]  1.234ms\n", "the log of arping"),
    ],
)
def test_a_file_without_delays_is_refused_by_name(refused, written, content, words):
    text = refused(written("mine.csv", content))
    assert text.endswith(words) or words in text
    assert "expected delays of packets, got" in text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("20\n21\n20\n", "--columns 'rtt=1(ms)' --interval 10ms for round trips"),
        ("20.5\n21\n22\n", "one number per line"),
        ("2.0\t25.0\n2.1\t16.0\n", "--format histogram for the low of a bin in ms and its count"),
        ("0.00,20\n0.01,20\n", "--columns 'sent=1(s),rtt=2(ms)' for a time"),
        ("1700000000000,20.5\n1700000000010,20.5\n", "--columns 'sent=1(ms),rtt=2(ms)' for a time"),
        ("1700000000000000000,00a\n1700000000100000000,00b\n", "--columns 'time=1(ns),id=2'"),
        ("Device: X\n\nt_s,rtt_ms\n0.0,20\n", "--columns 'sent=t_s,rtt=rtt_ms'"),
        ("time;RTT [ms]\n2023-11-14 22:13:20;20\n", "--columns 'sent=time,rtt=RTT [ms]'"),
        ("n,timestamp,latency\n1,1700000000123,20\n", "'sent=timestamp(ms),rtt=latency(ms)'"),
        ("sendTimeNs,recvTimeNs\n1,2\n", "--columns 'sent=sendTimeNs,received=recvTimeNs'"),
        ("t_s,u_ms,d_ms\n0,1,2\n", "--columns 'sent=t_s,uplink=u_ms,downlink=d_ms'"),
        ("n rtt_ms\n1 20\n2 21\n", "--columns 'rtt=rtt_ms' --interval 10ms"),
        ("dear diary\n", "--columns names the columns of any other table"),
        ("# a comment\n", "--columns names the columns"),
        ("time,pack\n2019-08-30 21:46:43,86.0\n", "a table of time, pack: name a time and a delay"),
        ("start,ping_avg,loss\n1700000000,57.7,0.4\n", "a table of sums (ping_avg, loss)"),
        ('{"t": 1.0, "rtt": 20.1}\n{"t": 1.1, "rtt": 20.4}\n', "JSON of no known program"),
        ("[20.1, 20.2]\n", "JSON of no known program"),
        ("t,RTT\n11/14/2023 10:13:20 PM,20\n", "--columns 'sent=t,rtt=RTT(ms)'"),
    ],
)
def test_what_is_like_no_format_is_told_what_it_resembles(refused, written, content, words):
    text = refused(written("mine.txt", content))
    assert "got other content" in text
    assert words in text


@pytest.mark.parametrize(
    "content", ["Device: X\n\nt_s,rtt_ms\n0.0,20\n0.1,20\n", "n rtt_ms\n1 20\n2 21\n"]
)
def test_the_columns_that_are_proposed_read_the_file(convert, refused, written, content):
    file = written("mine.txt", content)
    flags = refused(file).split("try ")[1]
    flag, columns, *interval = flags.replace("'", "").split(" ")
    assert set(convert(file, flag, columns, *interval).delays_ns[0, [0, -1]] // MS) == {10}


def test_times_that_never_decrease_are_those_of_mahimahi(written):
    assert format_of(written("a", "1\n2\n2\n5\n"), Options()).name == "mahimahi"
    assert format_of(written("b", "1\n2\n2\n5\n"), Options(columns={"rtt": "1"})).name == "table"


# Flent -----------------------------------------------------------------------------------------


def flent(values, **others):
    series = {
        "Ping (ms) ICMP": values,
        "TCP upload": [{"dur": 0.2, "t": 1.0, "val": 5.2}],
        **others,
    }
    text = json.dumps({"metadata": {}, "raw_values": series, "results": {}, "x_values": []})
    return gzip.compress(text.encode(), mtime=0)


def pings(*numbers):
    return [{"seq": float(n), "t": 1e9 + n / 10 + 0.02, "val": 20.0 + n} for n in numbers]


def test_flent_has_numbers_times_and_round_trips(convert, written):
    file = written("mine.flent.gz", flent(pings(1, 2, 4)))
    profile = convert(file, "--period", "100ms")
    assert profile.delays_ns[UPLINK].tolist() == [10_500_000, 11 * MS, LOST, 12 * MS]
    assert profile.metadata["format"] == "flent"


def test_of_several_series_of_flent_one_is_chosen(convert, refused, written):
    file = written("mine.flent.gz", flent(pings(1, 2), **{"Ping (ms) UDP": pings(3, 4)}))
    text = refused(file)
    assert "Ping (ms) ICMP, Ping (ms) UDP" in text
    assert "--columns 'rtt=Ping (ms) ICMP'" in text
    profile = convert(file, "--columns", "rtt=Ping (ms) UDP", "--period", "100ms")
    assert profile.delays_ns[UPLINK].tolist() == [11_500_000, 12 * MS]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([], "raw values of pings with numbers, got none"),
        ([{"dur": 0.2, "t": 1.0, "val": 5.2}], "got none"),
        ([*pings(1), {"t": 2.0}], "Ping (ms) ICMP, value 1: expected a seq, a time t and a val"),
        ([*pings(1), {"seq": "x", "t": 2.0, "val": 1}], "a whole seq, got 'x'"),
        ([*pings(1), {"seq": 2, "t": "x", "val": 1}], "a time in s, got 'x'"),
    ],
)
def test_a_file_of_flent_without_pings_is_refused(refused, written, values, words):
    assert words in refused(written("mine.flent.gz", flent(values)))
