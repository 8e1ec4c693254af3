from __future__ import annotations

import json
from datetime import datetime, timezone

import pytest

from netem.profile import DOWNLINK, LOST, UPLINK

MS = 1_000_000


@pytest.fixture
def irtt(sample, written):
    """irtt's sample with each round trip changed: `irtt(lambda k, trip: …)`."""

    def change(each):
        document = json.loads(sample("irtt_sample.json").read_text())
        for k, trip in enumerate(document["round_trips"]):
            each(k, trip)
        return written("irtt.json", json.dumps(document))

    return change


def lose(trip, how):
    trip["lost"] = how
    trip["delay"] = {}
    trip["timestamps"]["client"]["receive"] = {}
    trip["timestamps"]["server"] = {"receive": {}, "send": {}}


# The sample has a packet every 10 ms: a period each.
EACH = ("--period", "10ms")


def measured(profile, direction):
    assert profile.delays_ns.shape == (2, 20)
    return profile.delays_ns[direction].tolist()


def test_one_way_delays_are_those_of_the_file(convert, sample):
    profile = convert(sample("irtt_sample.json"), *EACH)
    trips = json.loads(sample("irtt_sample.json").read_text())["round_trips"]
    assert measured(profile, UPLINK) == [trip["delay"]["send"] for trip in trips]
    assert measured(profile, DOWNLINK) == [trip["delay"]["receive"] for trip in trips]
    assert profile.metadata["split"] == "one-way"
    assert profile.metadata["uplink_bytes"] == profile.metadata["downlink_bytes"] == 1000
    assert profile.metadata["rate_hz"] == 100
    assert any("clocks of the two ends" in note for note in profile.metadata["notes"])


@pytest.mark.parametrize("why", ["asked for", "no timestamps"])
def test_round_trips_are_halved_and_the_metadata_says_so(convert, sample, irtt, why):
    if why == "asked for":
        profile = convert(sample("irtt_sample.json"), "--clock", "half", *EACH)
    else:
        profile = convert(
            irtt(lambda k, trip: [trip["delay"].pop(w) for w in ("send", "receive")]), *EACH
        )
    trips = json.loads(sample("irtt_sample.json").read_text())["round_trips"]
    halves = [trip["delay"]["rtt"] // 2 for trip in trips]
    assert measured(profile, UPLINK) == halves
    sums = profile.delays_ns.sum(axis=0).tolist()
    assert sums == [trip["delay"]["rtt"] for trip in trips]
    assert profile.metadata["split"] == "half"


def test_a_loss_is_on_the_way_that_irtt_says(convert, irtt):
    how = {3: "true_up", 5: "true_down", 8: "true"}
    profile = convert(irtt(lambda k, trip: lose(trip, how[k]) if k in how else None), *EACH)
    up, down = measured(profile, UPLINK), measured(profile, DOWNLINK)
    assert [k for k, delay in enumerate(up) if delay == LOST] == [3, 8]
    assert [k for k, delay in enumerate(down) if delay == LOST] == [5, 8]
    assert profile.metadata["packets"] == {"uplink": 19, "downlink": 19}


@pytest.mark.parametrize("split", [(), ("--clock", "half")], ids=["one-way", "half"])
def test_a_loss_on_one_way_leaves_the_other_alone(convert, irtt, split):
    how = {3: "true_up", 5: "true_down"}
    file = irtt(lambda k, trip: lose(trip, how[k]) if k in how else None)
    profile = convert(file, *EACH, *split)
    assert (profile.delays_ns[UPLINK] == LOST).nonzero()[0].tolist() == [3]
    assert (profile.delays_ns[DOWNLINK] == LOST).nonzero()[0].tolist() == [5]


def test_lost_as_a_truth_value_is_understood(convert, irtt):
    def change(k, trip):
        trip["lost"] = False
        if k == 4:
            lose(trip, True)

    profile = convert(irtt(change), *EACH)
    assert measured(profile, UPLINK)[4] == measured(profile, DOWNLINK)[4] == LOST


@pytest.mark.parametrize("offset_ms", [-40, 300])
def test_clocks_that_differ_are_refused_until_told_how_to_treat_them(
    convert, refused, irtt, sample, offset_ms
):
    def change(k, trip):
        trip["delay"]["send"] += offset_ms * MS
        trip["delay"]["receive"] -= offset_ms * MS
        if k == 9:
            lose(trip, "true_down")

    file = irtt(change)
    text = refused(file)
    assert "--clock offset" in text
    assert "--clock half" in text
    profile = convert(file, "--clock", "offset", *EACH)
    trips = json.loads(sample("irtt_sample.json").read_text())["round_trips"]
    del trips[9]
    sent = [trip["delay"]["send"] for trip in trips]
    received = [trip["delay"]["receive"] for trip in trips]
    offset = (min(sent) - min(received)) // 2
    up, down = measured(profile, UPLINK), measured(profile, DOWNLINK)
    assert down.index(LOST) == 9
    # Of a packet lost on the way down the delay up is not known: that period is interpolated.
    assert up[:9] + up[10:] == [delay - offset for delay in sent]
    assert down[:9] + down[10:] == [delay + offset for delay in received]
    assert convert(file, "--clock", "half").metadata["split"] == "half"


def test_without_times_packets_are_an_interval_apart(convert, irtt):
    def change(k, trip):
        del trip["timestamps"]
        trip["delay"] = {"rtt": (k + 1) * 2000}

    profile = convert(irtt(change), *EACH)
    assert measured(profile, UPLINK) == [(k + 1) * 1000 for k in range(20)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda trip: trip.update(lost="perhaps"), ["lost as one of", "perhaps"]),
        (lambda trip: trip["delay"].update(send="5ms"), ["delay send in whole ns", "5ms"]),
        (lambda trip: trip["delay"].update(send=float("nan")), ["delay send", "nan"]),
        (lambda trip: trip["delay"].update(rtt=-1), ["delay rtt", "-1"]),
        (lambda trip: trip["timestamps"]["client"].update(send={"wall": 1.5}), ["sending", "1.5"]),
    ],
)
def test_a_wrong_round_trip_is_named_with_its_number(refused, irtt, change, words):
    text = refused(irtt(lambda k, trip: change(trip) if k == 7 else None))
    assert "irtt.json, round trip 7: expected" in text
    for word in words:
        assert word in text


def test_irtt_cut_off_is_named_with_its_line(refused, sample, written):
    text = sample("irtt_sample.json").read_text()
    half = text[: len(text) // 2]
    message = refused(written("irtt.json", half))
    assert f"line {half.count(chr(10)) + 1}: expected whole JSON" in message


def test_a_file_of_both_ways_stands_alone(refused, sample):
    file = sample("irtt_sample.json")
    assert "alone" in refused(file, file)
    assert "--other-way" in refused(file, "--other-way", "same")


# Pings ---------------------------------------------------------------------------------------


def log(*replies, heading="PING 10.0.0.1 (10.0.0.1) 56(84) bytes of data.\n", tail=""):
    return heading + "".join(reply + "\n" for reply in replies) + tail


def reply(sequence, milliseconds):
    return f"64 bytes from 10.0.0.1: icmp_seq={sequence} ttl=64 time={milliseconds} ms"


def test_a_log_with_times_has_a_ping_where_it_was_sent(convert, sample):
    file = sample("ping_D_sample.txt")
    profile = convert(file)
    sent, trips = [], []
    for line in file.read_text().splitlines():
        if line.startswith("["):
            trip_ns = round(float(line.split("time=")[1].split()[0]) * MS)
            stamp_us = int(line[1:18].replace(".", ""))
            sent.append(stamp_us * 1000 - trip_ns)
            trips.append(trip_ns)
    assert len(trips) == 20
    delays = profile.delays_ns[UPLINK].tolist()
    for at, trip in zip(sent, trips, strict=True):
        period = (at - sent[0]) // MS
        assert trip // 2 in delays[max(period - 1, 0) : period + 2]
    assert len(delays) == (sent[-1] - sent[0]) // MS + 1
    assert profile.metadata["split"] == "half"
    assert profile.metadata["uplink_bytes"] == 64
    assert profile.metadata["packets_lost"] == {"uplink": 0, "downlink": 0}


def test_a_plain_log_has_a_ping_every_interval(convert, written):
    file = written("p.log", log(reply(1, 4), reply(2, 8), reply(3, 6)))
    profile = convert(file, "--interval", "1ms")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS, 4 * MS, 3 * MS]


def test_without_an_interval_a_second_is_taken_and_said(convert, written):
    profile = convert(written("p.log", log(reply(1, 4), reply(2, 8))))
    assert profile.delays_ns.shape == (2, 1001)
    assert any("1 s apart" in note for note in profile.metadata["notes"])
    assert profile.metadata["rate_hz"] == 1


LINES = {
    "unreachable": "From 10.0.0.254 icmp_seq=3 Destination Host Unreachable",
    "nothing": None,
    "no answer": "no answer yet for icmp_seq=3",
    "macOS": "Request timeout for icmp_seq 3",
    "complaint": "ping: sendmsg: Network is unreachable",
    "macOS complaint": "92 bytes from router (192.168.1.1): Destination Host Unreachable\n"
    "Vr HL TOS  Len   ID Flg  off TTL Pro  cks      Src      Dst\n"
    " 4  5  00 5400 0000   0 0000  40  01 b755 192.168.1.5  10.0.0.1",
}


@pytest.mark.parametrize("kind", LINES)
def test_a_number_without_a_reply_is_lost_on_both_ways(convert, written, kind):
    lines = [reply(1, 4), reply(2, 4), *([LINES[kind]] if LINES[kind] else []), reply(4, 4)]
    profile = convert(written("p.log", log(*lines)), "--interval", "10ms", "--period", "10ms")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS, 2 * MS, LOST, 2 * MS]
    assert profile.metadata["packets_lost"] == {"uplink": 1, "downlink": 1}


def test_the_first_of_duplicates_counts_and_late_replies_are_no_loss(convert, written):
    lines = [reply(1, 2), reply(3, 2), reply(2, 12), reply(2, 14) + " (DUP!)", reply(4, 2)]
    profile = convert(written("p.log", log(*lines)), "--interval", "10ms", "--period", "10ms")
    assert profile.delays_ns[UPLINK].tolist() == [MS, 6 * MS, MS, MS]


def test_pings_at_either_end_that_the_statistics_count_are_lost(convert, written):
    tail = (
        "\n--- 10.0.0.1 ping statistics ---\n6 packets transmitted, 3 received, 50% packet loss\n"
    )
    lines = [reply(k, 2) for k in (2, 3, 4)]
    profile = convert(
        written("p.log", log(*lines, tail=tail)), "--interval", "10ms", "--period", "10ms"
    )
    assert profile.delays_ns[UPLINK].tolist() == [LOST, MS, MS, MS, LOST, LOST]


@pytest.mark.parametrize(
    "line",
    [
        "64 bytes from 8.8.8.8: icmp_seq={n} ttl=117 time=8.000 ms",
        "64 bytes from 8.8.8.8: seq={n} ttl=117 time=8.000 ms",
        "64 bytes from 8.8.8.8: icmp_req={n} ttl=117 time=8.00 ms",
        "64 bytes from dns.google (8.8.8.8): icmp_seq={n} ttl=117 time=8.00 ms",
        "64 bytes from 2001:db8::1%eth0: icmp_seq={n} ttl=64 time=8.0 ms",
        "16 bytes from 2001:db8::1, icmp_seq={n} hlim=64 time=8.000 ms",
        "11:22:33.123456 64 bytes from 8.8.8.8: icmp_seq={n} ttl=117 time=8.000 ms",
        "64 Bytes von 8.8.8.8: icmp_seq={n} ttl=117 Zeit=8,00 ms",
        "64 octets de 8.8.8.8 : icmp_seq={n} ttl=117 temps=8.00 ms",
        "64 bytes from 8.8.8.8: icmp_seq={n} ttl=117 time=8 ms (DUP!)",
    ],
)
def test_replies_of_every_ping_are_understood(convert, written, line):
    lines = [line.format(n=n) for n in range(3)]
    profile = convert(written("p.log", log(*lines, heading="")), "--interval", "1ms")
    assert profile.delays_ns[UPLINK].tolist() == [4 * MS] * 3


def test_an_interface_in_an_address_is_no_summary(convert, written):
    lines = [f"64 bytes from fe80::1%eth0: icmp_seq={n} ttl=64 time=8.0 ms" for n in range(1, 5)]
    lines.insert(2, "From fe80::2:3%12 Destination unreachable: Address unreachable")
    log = "\n".join(["PING fe80::1(fe80::1%eth0) 56 data bytes", *lines, ""])
    profile = convert(written("ping.log", log), "--period", "1s")
    assert profile.delays_ns[UPLINK].tolist() == [4 * MS] * 4


def test_numbers_go_on_after_65535(convert, written):
    lines = [reply(n % 65536, 2) for n in (65534, 65535, 65536, 65538)]
    profile = convert(written("p.log", log(*lines)), "--interval", "10ms", "--period", "10ms")
    assert profile.delays_ns[UPLINK].tolist() == [MS, MS, MS, LOST, MS]


def test_a_log_in_the_encoding_of_powershell_is_read(convert, written):
    text = log(reply(1, 4), reply(2, 4)).replace("\n", "\r\n")
    profile = convert(written("p.log", text.encode("utf-16")), "--interval", "1ms")
    assert profile.delays_ns[UPLINK].tolist() == [2 * MS] * 2


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("64 bytes from 10.0.0.1: icmp_seq=2 ttl=64 ti", "a reply as in"),
        ("64 bytes from 10.0.0.1: icmp_", "a reply as in"),
        ("[1795299931.5445", "a reply as in"),
        ("64 bytes from 10.0.0.1: icmp_seq=70000 ttl=64 time=2 ms", "from 0 to 65535"),
        ("PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.", "one run of ping, begun at line 1"),
    ],
)
def test_a_wrong_line_of_a_log_is_named(refused, written, line, words):
    text = refused(written("p.log", log(reply(1, 4), line)))
    assert "p.log, line 3: expected" in text
    assert words in text


def test_an_unfinished_last_line_is_left_out_and_told(convert, written):
    for torn in ("64 bytes from 10.0.0.1: icm", "64 bytes from 10.0.0.1: icmp_seq=3 tt", "[179529"):
        text = log(reply(1, 4), reply(2, 8)) + torn
        profile = convert(written("p.log", text), "--interval", "1ms")
        assert profile.delays_ns[UPLINK].tolist() == [2 * MS, 4 * MS]
        assert "left out line 4, which is unfinished" in profile.metadata["notes"]


STAMPS = {
    "-D": "[{t:.6f}] ",
    "epoch": "{t:.3f} ",
    "epoch in ms": "{ms} ",
    "ISO": "{d:%Y-%m-%dT%H:%M:%S.%f}+00:00 ",
    "date time": "[{d:%Y-%m-%d %H:%M:%S.%f}] ",
    "comma": "{d:%Y/%m/%d %H:%M:%S.%f}, ",
    "ts": "{d:%b %d %H:%M:%S.%f} ",
    "date": "{d:%a %b %e %H:%M:%S.%f} CET {d:%Y}: ",
    "date of other order": "{d:%a %d %b %Y %I:%M:%S.%f} {d:%p} UTC ",
    "time of day": "{d:%H:%M:%S.%f} ",
    "month first": "{d:%m/%d/%Y %I:%M:%S.%f %p} - ",
    "day first": "{d:%d.%m.%Y %H:%M:%S.%f} ",
    "ISO without separators": "{d:%Y%m%dT%H%M%S.%f}Z ",
    "syslog": "<13>1 {d:%Y-%m-%dT%H:%M:%S.%f}Z robot ping - - - ",
    "journal": "{d:%b %d %H:%M:%S.%f} robot ping[712]: ",
    "µs behind a colon": "{d:%Y-%m-%d %H:%M:%S:%f} ",
}


@pytest.mark.parametrize("heading", [False, True])
@pytest.mark.parametrize("stamp", STAMPS)
def test_a_time_before_a_line_tells_when_the_reply_came(convert, written, stamp, heading):
    # Across midnight, 0.1 s apart; the third one is lost.
    start = 1_700_006_399.9
    lines = ["PING 10.0.0.1 (10.0.0.1) 56(84) bytes of data."]
    stamps = [start]
    for k in (0, 1, 3, 4):
        lines.append(reply(k + 1, 20 + k))
        stamps.append(start + k / 10 + (20 + k) / 1000)
    lines += [
        "",
        "--- 10.0.0.1 ping statistics ---",
        "5 packets transmitted, 4 received, 20% packet loss",
    ]
    stamps += [stamps[-1]] * 3
    text = ""
    for k, (line, t) in enumerate(zip(lines, stamps, strict=True)):
        d = datetime.fromtimestamp(round(t, 3), timezone.utc)
        written_stamp = STAMPS[stamp].format(t=t, ms=round(t * 1000), d=d)
        text += (written_stamp if heading or 1 <= k <= 4 else "") + line + "\n"
    profile = convert(written("p.log", text), "--period", "100ms")
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_500_000, LOST, 11_500_000, 12 * MS]
    assert profile.metadata["packets"] == {"uplink": 5, "downlink": 5}


def test_the_interval_is_that_of_the_summary_where_no_times_are(convert, written):
    tail = "\n4 packets transmitted, 4 received, 0% packet loss, time 30ms\nrtt min/avg = 2/2 ms\n"
    file = written("p.log", log(*(reply(k, 2) for k in range(1, 5)), tail=tail))
    profile = convert(file)
    assert profile.delays_ns.shape == (2, 31)
    assert any("10 ms apart, as the summary says" in note for note in profile.metadata["notes"])
    assert convert(file, "--interval", "5ms").delays_ns.shape == (2, 16)


def test_times_of_whole_seconds_do_not_crowd_the_pings_of_a_second(convert, written):
    lines = [f"[{1_700_000_000 + k // 5}] {reply(k, 2)}" for k in range(11)]
    profile = convert(written("p.log", log(*lines)))
    assert profile.delays_ns.shape == (2, 2001)
    assert any("whole seconds" in note for note in profile.metadata["notes"])


def test_a_clock_that_was_set_back_during_a_log_is_told_and_goes_on(convert, written):
    lines = [f"[{1_700_000_000.002 + k / 10 - 5 * (k > 6):.6f}] {reply(k, 2)}" for k in range(20)]
    profile = convert(written("p.log", log(*lines)))
    assert abs(profile.delays_ns.shape[1] - 1901) <= 1
    assert any("set back by 5 s before the ping number 7" in n for n in profile.metadata["notes"])


def test_a_pause_shows_in_times_of_whole_seconds_too(refused, convert, written):
    lines = [f"[{1_700_000_000 + k + 100 * (k > 60)}] {reply(k, 2)}" for k in range(1, 121)]
    tail = "\n120 packets transmitted, 120 received, 0% packet loss, time 219000ms\n"
    file = written("p.log", log(*lines, tail=tail))
    assert "100 s without packets, 60 s after the first" in refused(file)
    assert convert(file, "--pause", "cut", "--period", "1s").delays_ns.shape == (2, 120)


@pytest.mark.parametrize("stamp", ["0.100000 ", "Q1 22:13:20.5 "])
def test_times_that_are_not_read_are_no_log_without_times(convert, refused, written, stamp):
    file = written("p.log", log(*(stamp + reply(k, 2) for k in range(1, 9))))
    assert "expected times as in [1700000000.5], 2023-11-14 22:13:20.5 or 22:13:20.5" in refused(
        file
    )
    assert convert(file, "--interval", "10ms").delays_ns.shape == (2, 71)


def test_times_since_the_line_before_are_refused(refused, written):
    lines = [f"00:00:00.{100_000 + 3000 * (k % 2):06d} {reply(k, 2)}" for k in range(1, 40)]
    assert "expected times that go on from ping to ping" in refused(written("p.log", log(*lines)))


def test_a_clock_that_was_set_forward_is_refused_as_a_pause(refused, written):
    lines = [f"[{1_700_000_000 + k / 10 + 5 * (k > 6):.6f}] {reply(k, 2)}" for k in range(20)]
    assert "5 s without packets" in refused(written("p.log", log(*lines)))


@pytest.mark.parametrize("unit", ["ms", "毫秒", "мс", "ミリ秒"])
@pytest.mark.parametrize(
    "line",
    [
        "64 字节，来自 192.0.2.7: icmp_seq={n} ttl=118 时间=9.72 {unit}",
        "64 байт от 192.0.2.7: icmp_seq={n} ttl=118 время=9,72 {unit}",
    ],
)
def test_milliseconds_are_understood_in_other_scripts(convert, written, line, unit):
    text = log(*(line.format(n=n, unit=unit) for n in (1, 3)), heading="PING 192.0.2.7\n")
    text += f"\n已发送 3 个包， 已接收 2 个包, 33.3% packet loss, time 20{unit}\n"
    profile = convert(written("p.log", text), "--period", "10ms")
    assert profile.delays_ns[UPLINK].tolist() == [4_860_000, LOST, 4_860_000]


WINDOWS = {
    "en": (
        "\nPinging h [192.0.2.7] with 32 bytes of data:\n{lines}\nPing statistics:\n"
        "    Packets: Sent = 4, Received = 3, Lost = 1 (25% loss),\n",
        "Reply from 192.0.2.7: bytes=32 time={t}ms TTL=51",
        "Request timed out.",
    ),
    "de": (
        "\nPing wird ausgeführt für 192.0.2.7 mit 32 Bytes Daten:\n{lines}\nPing-Statistik:\n"
        "    Pakete: Gesendet = 4, Empfangen = 3, Verloren = 1\n    (25% Verlust),\n",
        "Antwort von 192.0.2.7: Bytes=32 Zeit={t}ms TTL=51",
        "Zeitüberschreitung der Anforderung.",
    ),
    "ru": (
        "\nОбмен пакетами с 192.0.2.7 по с 32 байтами данных:\n{lines}\n",
        "Ответ от 192.0.2.7: число байт=32 время={t}мс TTL=51",
        "Превышен интервал ожидания для запроса.",
    ),
    "IPv6": (
        "Pinging 2001:db8::1 with 32 bytes of data:\n{lines}\n",
        "Reply from 2001:db8::1: time={t}ms ",
        "Reply from 2001:db8::2: Destination host unreachable.",
    ),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp866"])
@pytest.mark.parametrize("language", WINDOWS)
def test_the_pings_of_windows_are_read_in_any_language(convert, written, language, encoding):
    frame, answer, lost = WINDOWS[language]
    lines = [lost, *(answer.format(t=t) for t in (87, 12, 13))]
    text = frame.format(lines="\n".join(lines) + "\n").replace("\n", "\r\n")
    profile = convert(
        written("p.txt", text.encode(encoding, errors="replace")),
        "--interval",
        "10ms",
        "--period",
        "10ms",
    )
    assert profile.delays_ns[UPLINK].tolist() == [LOST, 43_500_000, 6 * MS, 6_500_000]
    assert profile.metadata["format"] == "ping"


def test_windows_that_says_other_numbers_than_its_lines_is_refused(refused, written):
    frame, answer, _ = WINDOWS["en"]
    text = frame.format(lines=answer.format(t=5) + "\n")
    assert "expected 1 pings sent" in refused(written("p.txt", text))
    two = frame.replace("4", "1").replace("3", "1").format(lines=answer.format(t=5) + "\n") * 2
    assert "one run of ping" in refused(written("p.txt", two))
    runs = log(reply(1, 2)) + log(reply(1, 3))
    assert refused(written("p.log", runs)).endswith("; cut the log there")
    text = refused(written("p.log", "\n".join((reply(1, 2), reply(2, 2), reply(1, 3)))))
    assert "line 3: expected one run of ping, with one reply to 1" in text


def test_a_time_below_a_millisecond_is_said(convert, written):
    frame, answer, _ = WINDOWS["IPv6"]
    text = frame.format(lines=answer.format(t=5).replace("=5", "<1") + "\n")
    notes = convert(written("p.txt", text)).metadata["notes"]
    assert any("below 1 ms count as 1 ms" in note for note in notes)


def test_fping_is_read_with_its_times(convert, refused, written):
    lines = [
        "[{t:.5f}] 192.0.2.7 : [0], 64 bytes, 12.3 ms (12.3 avg, 0% loss)",
        "[{t:.5f}] 192.0.2.7 : [1], timed out (NaN avg, 50% loss)",
        "[{t:.5f}] 192.0.2.7 : [2], 64 bytes, 11.3 ms (11.8 avg, 33% loss)",
    ]
    text = "".join(line.format(t=1_700_000_000.1 + k / 10) + "\n" for k, line in enumerate(lines))
    profile = convert(written("f.txt", text), "--period", "100ms")
    assert profile.delays_ns[UPLINK].tolist() == [6_150_000, LOST, 5_650_000]
    assert profile.metadata["uplink_bytes"] == 64
    text += "[1700000000.5] 192.0.2.8 : [0], 64 bytes, 12.3 ms (12.3 avg, 0% loss)\n"
    assert "line 4: expected one host, 192.0.2.7, got '192.0.2.8'" in refused(
        written("f.txt", text)
    )


def test_a_log_without_replies_is_refused(refused, written):
    text = refused(written("p.log", log("From 10.0.0.254 icmp_seq=1 Destination Host Unreachable")))
    assert "a line for each reply" in text
    alone = (
        "\n--- 10.0.0.1 ping statistics ---\n100 packets transmitted, 98 received, 2% packet loss"
    )
    text = refused(written("p.log", log(tail=alone)))
    assert text.endswith("got none of 100; ping a host that answers, without -q and -f")
