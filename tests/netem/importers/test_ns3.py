from __future__ import annotations

import gzip
from decimal import Decimal

import numpy as np
import pytest

from netem.profile import DOWNLINK, LOST, UPLINK

EVENTS = "TYPE\tTIME\tCellId\tIMSI\tRNTI\tLCID\tSIZE\tDELAY\t\n"


def rows_of(path):
    return [line.split("\t") for line in path.read_text().splitlines()[1:]]


def longest_by_millisecond(path, rnti="1"):
    """Per whole ms of sending the longest DELAY [ns], by the decimal digits of the file."""
    longest: dict[int, int] = {}
    for kind, time, _, _, row_rnti, lcid, _, delay, *_ in rows_of(path):
        if kind == "Rx" and int(lcid) >= 3 and row_rnti == rnti:
            sent_ms = (Decimal(time) - Decimal(delay) / 10**9) * 1000
            # Times have six digits, so 399.9995 is 400; fragments follow within 40 µs.
            key = int(sent_ms + Decimal("0.01"))
            longest[key] = max(longest.get(key, 0), int(delay))
    return longest


def event(kind, time, size=1030, delay=0, *, cell=1, imsi=1, rnti=1, lcid=3):
    return f"{kind}\t{time:.6g}\t{cell}\t{imsi}\t{rnti}\t{lcid}\t{size}\t{delay}\t\n"


def message(time, delay_ns, **other):
    return event("Tx", time, **other), event("Rx", time + delay_ns * 1e-9, delay=delay_ns, **other)


def test_each_millisecond_has_the_longest_delay_of_the_packets_sent_in_it(convert, sample):
    uplink, downlink = (sample(f"{way}PdcpStats_perpacket.txt") for way in ("Ul", "Dl"))
    profile = convert(uplink, downlink)
    up, down = longest_by_millisecond(uplink), longest_by_millisecond(downlink)
    both = sorted(set(up) & set(down))
    assert both == [401, 402, 403, 404]
    assert profile.delays_ns[UPLINK].tolist() == [up[k] for k in both]
    assert profile.delays_ns[DOWNLINK].tolist() == [down[k] for k in both]
    assert profile.metadata["source"] == [uplink.name, downlink.name]
    assert profile.metadata["format"] == "ns3"


def test_one_way_alone_is_as_long_as_it_is(convert, sample):
    uplink = sample("UlPdcpStats_perpacket.txt")
    profile = convert(uplink, "--other-way", "constant:5ms")
    up = longest_by_millisecond(uplink)
    assert profile.delays_ns[UPLINK].tolist() == [up[k] for k in sorted(up)]
    assert set(profile.delays_ns[DOWNLINK].tolist()) == {5_000_000}
    assert any("not measured, 5 ms" in note for note in profile.metadata["notes"])


def test_epochs_of_the_same_name_have_their_mean_in_seconds(convert, sample):
    profile = convert(*(sample(f"{way}PdcpStats_aggregated.txt") for way in ("Ul", "Dl")))
    # 0.25 to 0.5 s; of two columns called min and max the delay's come first.
    assert profile.delays_ns.shape == (2, 250)
    assert set(profile.delays_ns[UPLINK].tolist()) == {673_059}
    assert set(profile.delays_ns[DOWNLINK].tolist()) == {654_195}
    assert any("means over epochs" in note for note in profile.metadata["notes"])


def test_an_epoch_in_which_nothing_arrived_is_lost(convert, written):
    header = "% start\tend\tCellId\tIMSI\tRNTI\tLCID\tnTxPDUs\tTxBytes\tnRxPDUs\tRxBytes\tdelay\n"
    rows = ["0\t0.01\t1\t1\t1\t3\t9\t9\t9\t9\t0.002", "0.01\t0.02\t1\t1\t1\t3\t9\t9\t0\t0\t0"]
    file = written("UlRlcStats.txt", header + "\n".join(rows))
    assert convert(file, "--other-way", "same").delays_ns[UPLINK].tolist() == (
        [2_000_000] * 10 + [LOST] * 10
    )


@pytest.mark.parametrize(("way", "packets", "untimed"), [("Ul", 20, 20), ("Dl", 40, 22)])
def test_what_rlc_sends_for_itself_or_again_is_left_out(convert, sample, way, packets, untimed):
    file = sample(f"{way}RlcStats_perpacket.txt")
    profile = convert(file, "--other-way", "same")
    longest = {k: delay for k, delay in longest_by_millisecond(file).items() if delay}
    assert (
        sum(row[0] == "Rx" and row[5] == "3" and row[7] == "0" for row in rows_of(file)) == untimed
    )
    assert set(longest.values()) <= set(profile.delays_ns[UPLINK].tolist())
    assert profile.delays_ns.min() == min(longest.values())
    assert profile.metadata["packets"]["uplink"] == packets
    assert profile.metadata["packets_lost"]["uplink"] == 0
    assert any(f"{untimed} PDUs without a delay" in note for note in profile.metadata["notes"])


@pytest.mark.parametrize("start", [0.4, 7.0, 31.0])
def test_a_sending_without_a_reception_is_a_loss(convert, written, start):
    # From 10 s on a time is good to 0.1 ms only, and several sendings share one.
    rows = []
    for k in range(40):
        for fragment in range(3):
            sent, received = message(start + k * 1e-3 + fragment * 1e-6, 1_234_567)
            partly, wholly = k == 5 and fragment == 1, k in (10, 11)
            rows += [sent] if partly or wholly else [sent, received]
    rows.sort(key=lambda row: float(row.split("\t")[1]))
    profile = convert(written("UlPdcpStats.txt", EVENTS + "".join(rows)), "--other-way", "same")
    lost = [k for k, delay in enumerate(profile.delays_ns[UPLINK].tolist()) if delay == LOST]
    assert lost == [10, 11]
    assert profile.metadata["packets_lost"]["uplink"] == 7


def test_what_was_sent_just_before_the_record_ended_is_not_lost(convert, written):
    rows = [row for k in range(10) for row in message(0.4 + k * 1e-3, 3_000_000)]
    rows += [event("Tx", 0.4 + k * 1e-3) for k in range(10, 13)]
    rows.sort(key=lambda row: float(row.split("\t")[1]))
    profile = convert(written("UlPdcpStats.txt", EVENTS + "".join(rows)), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [3_000_000] * 10
    assert any(note.startswith("3 packets left out") for note in profile.metadata["notes"])


def test_receptions_of_5g_lena_were_sent_their_delay_before(convert, written):
    text = "time(s)\tcellId\trnti\tlcid\tpacketSize\tdelay(s)\n"
    text += "0.4005\t1\t1\t4\t1030\t0.0005\n0.4026\t1\t1\t4\t1030\t0.0016\n"
    text += "0.402\t1\t1\t1\t30\t0.1\n0.4025\t1\t1\t4\t1030\t0.0005\n"
    files = [written(f"Nr{way}PdcpRxStats.txt", text) for way in ("Ul", "Dl")]
    profile = convert(*files)
    assert profile.delays_ns.tolist() == [[500_000, 1_600_000, 500_000]] * 2
    assert any("losses are unknown" in note for note in profile.metadata["notes"])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: "# a comment\n\n" + text.replace("\n", "\n\n# another\n", 1),
        lambda text: text.replace("\t", "  "),
        lambda text: "\n".join(line + "\textra" for line in text.splitlines()),
        lambda text: text.rstrip("\n"),
        lambda text: text.replace("TYPE", " Type ").replace("RNTI", "rnti"),
    ],
    ids=["CRLF", "BOM", "comments", "blanks", "extra column", "no last end", "header"],
)
@pytest.mark.parametrize("name", ["UlPdcpStats_perpacket.txt", "UlPdcpStats_aggregated.txt"])
def test_the_look_of_a_file_does_not_matter(convert, sample, written, name, change):
    expected = convert(sample(name), "--other-way", "same")
    changed = written("UlPdcpStats.txt", change(sample(name).read_text()))
    got = convert(changed, "--other-way", "same")
    assert got.delays_ns.tolist() == expected.delays_ns.tolist()


def test_a_gzipped_file_is_read_as_it_is(convert, sample, written):
    name = "UlPdcpStats_perpacket.txt"
    expected = convert(sample(name), "--other-way", "same")
    packed = written(name + ".gz", gzip.compress(sample(name).read_bytes()))
    got = convert(packed, "--other-way", "same")
    assert got.delays_ns.tolist() == expected.delays_ns.tolist()


def test_of_several_terminals_one_is_chosen(convert, refused, written):
    rows = [
        row
        for k in range(5)
        for n in (1, 2)
        for row in message(0.4 + k * 1e-3, n * 1000, rnti=n, imsi=n + 10)
    ]
    file = written("UlPdcpStats.txt", EVENTS + "".join(rows))
    assert "--rnti" in refused(file, "--other-way", "same")
    profile = convert(file, "--other-way", "same", "--rnti", "2")
    assert profile.delays_ns[UPLINK].tolist() == [2000] * 5
    text = refused(file, "--other-way", "same", "--rnti", "9")
    assert "RNTI 9, found none" in text
    assert "IMSI 11, RNTI 1; cell 1, IMSI 12, RNTI 2" in text
    profile = convert(file, "--other-way", "same", "--imsi", "11")
    assert profile.delays_ns[UPLINK].tolist() == [1000] * 5


def test_terminals_of_two_cells_with_one_number_are_two(convert, refused, written):
    def rows(imsi):
        return [
            row
            for k in range(5)
            for n in (1, 2)
            for row in message(0.4 + k * 1e-3, n * 1000, cell=n, imsi=n * imsi)
        ]

    file = written("UlPdcpStats.txt", EVENTS + "".join(rows(1)))
    text = refused(file, "--other-way", "same", "--rnti", "1")
    assert "expected one terminal, got 2: cell 1, IMSI 1, RNTI 1; cell 2, IMSI 2, RNTI 1" in text
    for flag in ("--imsi", "--cell", "--rnti"):
        assert flag in text
    profile = convert(file, "--other-way", "same", "--imsi", "2")
    assert profile.delays_ns[UPLINK].tolist() == [2000] * 5
    # Without an IMSI it is the cell that tells them apart.
    file = written("UlPdcpStats.txt", EVENTS + "".join(rows(0)))
    assert "expected one terminal, got 2" in refused(file, "--other-way", "same")
    assert convert(file, "--other-way", "same", "--cell", "1").delays_ns.max() == 1000


def test_a_terminal_that_is_handed_over_is_one(convert, written):
    rows = [r for k in range(3) for r in message(0.4 + k * 1e-3, 1000)]
    rows += [r for k in range(3, 6) for r in message(0.4 + k * 1e-3, 2000, cell=2, rnti=7)]
    profile = convert(written("UlPdcpStats.txt", EVENTS + "".join(rows)), "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [1000] * 3 + [2000] * 3


EPOCHS = "% start\tend\tCellId\tIMSI\tRNTI\tLCID\tnTxPDUs\tTxBytes\tnRxPDUs\tRxBytes\tdelay\n"


def epoch(k, sent, received, delay, length=0.005):
    times = f"{k * length:.6g}\t{(k + 1) * length:.6g}"
    return f"{times}\t1\t1\t1\t3\t{sent}\t0\t{received}\t0\t{delay}\n"


def test_what_arrives_in_a_later_epoch_is_not_lost(convert, written):
    # Sent in every epoch, 12 ms under way: two or three epochs later.
    rows = [epoch(k, 2, 0 if k < 2 else 2, 0 if k < 2 else 0.012) for k in range(60)]
    profile = convert(written("UlPdcpStats.txt", EPOCHS + "".join(rows)), "--other-way", "same")
    assert set(profile.delays_ns[UPLINK].tolist()) == {12_000_000}
    assert profile.metadata["packets_lost"]["uplink"] == 0


def test_epochs_of_which_nothing_arrives_later_are_lost(convert, written):
    dead = range(20, 30)
    rows = [
        epoch(k, 1, 0 if k < 2 or k - 2 in dead else 1, 0 if k < 2 or k - 2 in dead else 0.01)
        for k in range(60)
    ]
    profile = convert(written("UlPdcpStats.txt", EPOCHS + "".join(rows)), "--other-way", "same")
    lost = (profile.delays_ns[UPLINK] == LOST).nonzero()[0]
    assert lost.tolist() == list(range(100, 150))
    assert profile.metadata["packets_lost"]["uplink"] == 10


def test_losses_within_an_epoch_are_counted(convert, written):
    rows = [epoch(k, 4, 3 if k == 5 else 4, 0.002, length=0.25) for k in range(20)]
    profile = convert(written("UlPdcpStats.txt", EPOCHS + "".join(rows)), "--other-way", "same")
    assert profile.metadata["packets"]["uplink"] == 80
    assert profile.metadata["packets_lost"]["uplink"] == 1


@pytest.mark.parametrize("imsi", ["", "1 "])
def test_events_without_a_header_are_known_by_their_shape(convert, written, imsi):
    rows = [
        f"Tx {0.1 + k * 1e-3:.6g} 1 {imsi}1 3 100 \n"
        + f"Rx {0.1005 + k * 1e-3:.6g} 1 {imsi}1 3 100 500000\n" * (k != 7)
        for k in range(20)
    ]
    profile = convert(written("DlPdcpStats.txt", "".join(rows)), "--other-way", "same")
    assert profile.delays_ns[DOWNLINK].tolist() == [LOST if k == 7 else 500_000 for k in range(20)]


def test_receptions_without_a_header_have_delays_in_nanoseconds(convert, written, capsys):
    rows = "".join(f"{0.1005 + k * 1e-3:.6g}\t1\t1\t1\t3\t100\t500000\n" for k in range(20))
    profile = convert(written("DlPdcpStats.txt", rows), "--other-way", "same")
    assert set(profile.delays_ns[DOWNLINK].tolist()) == {500_000}
    assert profile.metadata["packets_lost"]["downlink"] is None
    assert "20 packets, of lost ones nothing is known" in capsys.readouterr().out


def test_sendings_beside_receptions_tell_what_was_lost(convert, refused, written):
    sent = "time(s)\tcellId\trnti\tlcid\tpacketSize\n"
    sent += "".join(f"{0.4 + k * 1e-3:.6g}\t1\t1\t4\t1030\n" for k in range(30))
    arrived = "time(s)\tcellId\trnti\tlcid\tpacketSize\tdelay(s)\n"
    arrived += "".join(
        f"{0.4005 + k * 1e-3:.6g}\t1\t1\t4\t1030\t0.0005\n" for k in range(30) if k != 9
    )
    names = ("UlRx.txt", "UlTx.txt", "DlRx.txt", "DlTx.txt")
    up, up_sent, down, down_sent = (
        written(f"mine-Nr{name}", arrived if "Rx" in name else sent) for name in names
    )
    expected = [LOST if k == 9 else 500_000 for k in range(30)]
    assert convert(up, up_sent, down, down_sent).delays_ns.tolist() == [expected] * 2
    # Those beside it by their name are found.
    profile = convert(up, down)
    assert profile.delays_ns.tolist() == [expected] * 2
    assert any("mine-NrUlTx.txt" in note for note in profile.metadata["notes"])
    other = written("NrUlRxStats-1.txt", arrived)
    assert convert(other, up_sent, "--other-way", "same").delays_ns.tolist() == [expected] * 2
    assert "sendings, which have no delays" in refused(up_sent)
    assert "beside it" in refused(up, down, up_sent, written("x-NrUlTx.txt", sent))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("Rx\t0.5\t1\t1\t1\t3\t1030\n", "8 columns"),
        ("Rx\t0.5\t1\t1\t1\t3\t1030\t-5\n", "delay in whole ns, got '-5'"),
        ("Rx\t0.5\t1\t1\t1\t3\t1030\tnan\n", "delay in whole ns, got 'nan'"),
        ("Rx\tx\t1\t1\t1\t3\t1030\t5\n", "a time in s, got 'x'"),
        ("Up\t0.5\t1\t1\t1\t3\t1030\t5\n", "Tx or Rx, got 'Up'"),
        ("Rx\t0.5\t1\t1\t1\tthree\t1030\t5\n", "an LCID, got 'three'"),
    ],
)
def test_a_wrong_row_is_named_with_its_line(refused, written, row, words):
    good = "".join(message(0.4, 1000))
    message_text = refused(written("UlPdcpStats.txt", EVENTS + good + row), "--other-way", "same")
    assert "UlPdcpStats.txt, line 4: expected" in message_text
    assert words in message_text


def test_delays_in_seconds_where_nanoseconds_belong_are_refused(refused, written):
    row = event("Rx", 0.4005, delay=1).replace("\t1\t\n", "\t0.0005\t\n")
    message_text = refused(written("UlPdcpStats.txt", EVENTS + row), "--other-way", "same")
    assert "expected Rx rows with a delay" in message_text


@pytest.mark.parametrize("delay", ["7200", "1e9"])
def test_hours_of_delay_are_refused(refused, written, delay):
    text = f"time(s)\tcellId\trnti\tlcid\tpacketSize\tdelay(s)\n8000\t1\t1\t4\t9\t{delay}\n"
    assert "units" in refused(written("NrUlPdcpRxStats.txt", text), "--other-way", "same")


def test_transport_blocks_become_the_bytes_carried_in_each_millisecond(convert, sample):
    trace = sample("RxPacketTrace.txt")
    profile = convert(sample("UlPdcpStats_perpacket.txt"), "--other-way", "same", "--phy", trace)
    carried: dict[str, dict[int, int]] = {"DL": {}, "UL": {}}
    for way, time, *cells in rows_of(trace):
        # Packets leave on the millisecond: a period begins half a millisecond before.
        key = int(Decimal(time) * 1000 + Decimal("0.5"))
        size = int(cells[8]) if cells[12] == "0" else 0
        carried[way][key] = carried[way].get(key, 0) + size
    for way, name in (("UL", "uplink"), ("DL", "downlink")):
        expected = [carried[way].get(k, 0) for k in range(400, 420)]
        assert profile.columns[f"{name}_capacity_bytes"].tolist() == expected
        assert sum(expected) > 0
    sinr = profile.columns["sinr_dl_db"]
    assert 47 < np.nanmin(sinr) < np.nanmax(sinr) < 48
    # In the first millisecond nothing was sent down.
    assert np.isnan(sinr).tolist() == [True] + [False] * 19


@pytest.mark.parametrize(
    "header",
    [
        "\ttime\tframe\tsubF\t1stSym\tsymbol#\tcellId\trnti\tccId\ttbSize\tmcs\trv\tSINR(dB)\t"
        "corrupt\tTBler",
        "DL/UL\ttime\tframe\tsubF\tslot\t1stSym\tcellId\trnti\tccId\ttbSize\tmcs\trv\tSINR(dB)\t"
        "corrupt\tTBler",
    ],
    ids=["older", "newer"],
)
def test_a_corrupt_block_carries_nothing(convert, sample, written, header):
    rows = [
        f"UL\t{0.4 + k * 1e-3:.6g}\t1\t1\t1\t1\t1\t1\t0\t{1000 + k}\t28\t0\t30 \t{k % 2}\t0\n"
        for k in range(20)
    ]
    trace = written("RxPacketTrace.txt", header + "\n" + "".join(rows))
    profile = convert(sample("UlPdcpStats_perpacket.txt"), "--other-way", "same", "--phy", trace)
    expected = [0 if k % 2 else 1000 + k for k in range(20)]
    assert profile.columns["uplink_capacity_bytes"].tolist() == expected
    assert "downlink_capacity_bytes" not in profile.columns


def test_transport_blocks_alone_have_no_delays(refused, sample):
    text = refused(sample("RxPacketTrace.txt"))
    assert "expected delays of packets, got transport blocks" in text
    assert "--phy" in text


def test_transport_blocks_of_another_time_are_refused(refused, sample, written):
    trace = sample("RxPacketTrace.txt").read_text().replace("\t0.", "\t9.")
    text = refused(
        *(sample("UlPdcpStats_perpacket.txt"), "--other-way", "same"),
        *("--phy", written("RxPacketTrace.txt", trace)),
    )
    assert "do not overlap" in text


def test_sums_without_packets_are_refused(refused, written):
    text = refused(written("flowmon.xml", '<?xml version="1.0" ?>\n<FlowMonitor>\n<FlowStats>\n'))
    assert "PdcpStats" in text
