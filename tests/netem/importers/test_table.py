from __future__ import annotations

import pyarrow as pa
import pytest
from pyarrow import parquet

from netem.profile import DOWNLINK, LOST, UPLINK
from shared.errors import UserError

MS = 1_000_000
# The header and the columns of CICV5G; the last row has two columns more, as some of its files.
CICV5G = """pub_time(ms) sub_time(ms) delay(ms) utmX(m) utmY(m) cellid(db) sinr(db)
1721808645000 1721808645019 19 329233.74 3463452.74 5C4225714 7 \n\
1721808645050 1721808645319 269 329233.74 3463452.74 5C4225714 7 \n\
1721808645100 1721808645319 219 329233.74 3463452.74 5C4225714 7 \n\
1721808645150 1721808645319 169 329233.74 3463452.74 5C4225714 7 1 2
"""
EACH = ("--period", "50ms", "--other-way", "same")


@pytest.mark.parametrize(
    "columns",
    [
        (),
        ("--columns", "sent=pub_time(ms),received=sub_time(ms)"),
        ("--columns", "sent=pub_time(ms),delay=delay(ms)"),
        ("--columns", "sent=pub_time,delay=delay", "--unit", "ms"),
        ("--columns", "sent = PUB_TIME(ms), delay = Delay(ms)"),
    ],
    ids=["known", "received", "delay", "bare names", "capitals"],
)
def test_delays_are_received_less_sent_or_as_given(convert, written, columns):
    profile = convert(written("urban.txt", CICV5G), *columns, *EACH)
    assert profile.delays_ns[UPLINK].tolist() == [19 * MS, 269 * MS, 219 * MS, 169 * MS]


def test_behind_the_stall_of_a_table_each_millisecond_waits_one_less(convert, written):
    profile = convert("--downlink", written("urban.txt", CICV5G), "--other-way", "constant:5ms")
    delays = profile.delays_ns[DOWNLINK].tolist()
    assert delays[50:] == [(319 - k) * MS for k in range(50, 151)]


@pytest.mark.parametrize(
    "text",
    [
        "t_s,d_ms\n0.00,20.5\n0.05,lost\n0.10,\n0.15,21\n",
        "t_s;d_ms\n0,00;20,5\n0,05;lost\n0,10;\n0,15;21\n",
        "t_s\td_ms\n0.00\t20.5\n0.05\tlost\n0.10\tNone\n0.15\t21\n",
        '"t_s","d_ms","x"\n"0.00","20.5","a,b"\n"0.05","lost",""\n"0.10","",""\n0.15,21,\n',
        "# of a run\r\nt_s, d_ms\r\n0.00, 20.5\r\n\r\n0.05, lost\r\n0.10, \r\n0.15, 21\r\n",
        "x,t_s,d_ms\n,0.15,21\n,0.00,20.5\n,0.10,\n,0.05,lost\n",
    ],
    ids=["commas", "semicolons", "tabs", "quotes", "comments", "in any order"],
)
def test_the_look_of_a_table_does_not_matter(convert, written, text):
    profile = convert(written("t.csv", text), "--columns", "sent=t_s,delay=d_ms", *EACH)
    assert profile.delays_ns[UPLINK].tolist() == [20_500_000, LOST, LOST, 21 * MS]


def test_columns_without_names_are_counted(convert, written):
    file = written("t.dat", "0.5 20 9\n0.55 30 9\n")
    profile = convert(file, "--columns", "sent=1,delay=2", "--unit", "ms", "--other-way", "same")
    assert profile.delays_ns[UPLINK].tolist() == [30 * MS]


def test_a_table_of_both_ways_needs_no_other(convert, written):
    text = "t(s),up(us),down(us)\n0,100,200\n0.001,lost,300\n0.002,150,250\n"
    profile = convert(written("t.csv", text), "--columns", "sent=t,uplink=up,downlink=down")
    assert profile.delays_ns.tolist() == [[100_000, LOST, 150_000], [200_000, 300_000, 250_000]]


def test_round_trips_of_a_table_are_halved(convert, written):
    text = "t(s),rtt(us)\n0,100\n0.001,lost\n0.002,150\n"
    profile = convert(written("t.csv", text), "--columns", "sent=t,rtt=rtt")
    assert profile.delays_ns.tolist() == [[50_000, LOST, 75_000]] * 2
    assert profile.metadata["split"] == "half"


def test_times_since_1970_in_nanoseconds_keep_their_last_digit(convert, written):
    start = 1_795_299_931_544_576_001
    text = "".join(f"{start + k * MS} {start + k * MS + 7}\n" for k in range(3))
    profile = convert(
        written("t.dat", text), "--columns", "sent=1,received=2", "--unit", "ns", *EACH[2:]
    )
    assert profile.delays_ns.tolist() == [[7] * 3] * 2


def test_clocks_of_two_tables_are_made_one(convert, refused, written):
    up = written("up.csv", "".join(["s(ms),r(ms)\n", *(f"{k},{k + 25}\n" for k in range(40))]))
    down = written("down.csv", "".join(["s(ms),r(ms)\n", *(f"{k},{k - 15}\n" for k in range(60))]))
    columns = ("--columns", "sent=s,received=r")
    assert "--clock offset" in refused(up, down, *columns)
    profile = convert(up, down, *columns, "--clock", "offset")
    assert set(profile.delays_ns.ravel().tolist()) == {5 * MS}


@pytest.mark.parametrize("missing", [None, 3])
def test_parquet_as_deterministic6g_publishes_it_is_known(convert, tmp_path, missing):
    sent = [1_700_000_000_000_000_000 + k * MS for k in range(10)]
    received = [None if k == missing else s + 4 * MS + k for k, s in enumerate(sent)]
    names = ("timestamps.client.send.wall", "timestamps.server.receive.wall")
    file = tmp_path / "s1.parquet"
    parquet.write_table(pa.table({names[0]: sent, names[1]: received, "x": ["a"] * 10}), file)
    profile = convert("--uplink", file, "--other-way", "constant:3ms")
    expected = [LOST if k == missing else 4 * MS + k for k in range(10)]
    assert profile.delays_ns[UPLINK].tolist() == expected


@pytest.mark.parametrize(
    ("values", "words"),
    [([True, False], "numbers"), ([float("-inf"), 1.0], "finite"), ([1e300, 1.0], "finite")],
)
def test_a_column_of_parquet_without_times_is_refused(refused, tmp_path, values, words):
    file = tmp_path / "a.parquet"
    parquet.write_table(pa.table({"t": [0, 1], "d": values}), file)
    columns = ("--columns", "sent=t,delay=d", "--unit", "ms")
    assert words in refused(file, *columns, "--other-way", "same")
    assert "column nobody" in refused(file, "--columns", "sent=t,delay=nobody", "--unit", "ms")


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("5,x", "delay as a number, got 'x'"),
        ("5,-inf", "delay as a number, got '-inf'"),
        (",5", "sent as a number, got ''"),
        ("lost,5", "sent as a number, got 'lost'"),
        ("5", "2 columns, got '5'"),
        ("1e18,5", "sent as a number"),
    ],
)
def test_a_wrong_row_is_named_with_its_line(refused, written, row, words):
    file = written("t.csv", f"t(s),d(ms)\n1,2\n{row}\n3,4\n")
    text = refused(file, "--columns", "sent=t,delay=d", "--other-way", "same")
    assert "t.csv, line 3: expected" in text
    assert words in text


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (("--columns", "sent=t,delay=d2"), "a column d2"),
        (("--columns", "sent=t"), "expected sent=NAME (or --interval) and received="),
        (("--columns", "sent=t,size=d"), "expected sent=NAME (or --interval) and received="),
        (("--columns", "delay=d"), "expected sent=NAME (or --interval) and received="),
        (("--columns", "sent=t,uplink=d"), "both uplink= and downlink="),
        (("--columns", "sent=t,delay=e"), "its unit in its name"),
        (("--columns", "sent=t,delay=e", "--unit", "h"), "--unit: expected its unit"),
        (("--columns", "sent"), "expected columns as in"),
    ],
)
def test_columns_that_say_too_little_are_refused(refused, written, columns, words):
    file = written("t.csv", "t(s),d(ms),e\n1,2,3\n")
    assert words in refused(file, *columns, "--other-way", "same")


# What lost looks like --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "mark",
    [
        "nan",
        "-nan",
        "#N/A",
        "Request timed out",
        "NA",
        "N/A",
        "-",
        "--",
        "timeout",
        "Timed Out",
        "",
    ],
)
def test_what_stands_for_lost_is_lost(convert, written, mark):
    file = written("t.csv", f"t_s,rtt_ms\n0,20\n0.05,{mark}\n0.1,20\n")
    profile = convert(file, "--columns", "sent=t_s,rtt=rtt_ms", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, LOST, 10 * MS]


@pytest.mark.parametrize("mark", ["0", "-1", "-1.0", "-999", "9999"])
def test_a_value_that_stands_for_lost_is_named(convert, written, tmp_path, mark):
    columns = ("--columns", "sent=t_s,rtt=rtt_ms", *EACH[:2], "--lost", f"{float(mark):g}")
    text = f"t_s,rtt_ms\n0,20\n0.05,{mark}\n0.1,20\n"
    assert convert(written("t.csv", text), *columns).delays_ns[UPLINK].tolist()[1] == LOST
    table = pa.table({"t_s": [0.0, 0.05, 0.1], "rtt_ms": [20.0, float(mark), 20.0]})
    parquet.write_table(table, tmp_path / "t.parquet")
    assert convert(tmp_path / "t.parquet", *columns).delays_ns[UPLINK].tolist()[1] == LOST


@pytest.mark.parametrize("clock", [(), ("--clock", "offset")])
def test_negatives_that_are_all_one_value_are_no_matter_of_clocks(refused, written, clock):
    rows = "".join(f"{k / 20},20,{-1 if k % 5 == 1 else 20}\n" for k in range(20))
    file = written("t.csv", "t_s,u_ms,d_ms\n" + rows)
    text = refused(file, "--columns", "sent=t_s,uplink=u_ms,downlink=d_ms", *clock)
    assert "t.csv, line 3: expected downlink as a time, got -1, as in 4 of 20 rows" in text
    assert "--lost -1" in text


def test_two_values_may_stand_for_lost(convert, refused, written):
    # As in tables made from irtt's files: −1 on the way of the loss, 0 on the other.
    rows = "".join(
        f"{k / 20},{0 if k % 5 == 1 else 20},{-1 if k % 5 == 1 else 20}\n" for k in range(20)
    )
    file = written("t.csv", "t_s,u_ms,d_ms\n" + rows)
    columns = ("--columns", "sent=t_s,uplink=u_ms,downlink=d_ms")
    assert "got -1, as in 4 of 20 rows" in refused(file, *columns)
    assert refused(file, *columns, "--lost", "0").endswith("try --lost=0,-1 if these were lost")
    notes = convert(file, *columns, "--lost", "-1").metadata["notes"]
    assert "4 of 20 uplink values are exactly 0; if lost, try --lost=-1,0" in notes
    profile = convert(file, *columns, "--lost=-1,0")
    assert profile.metadata["packets_lost"] == {"uplink": 4, "downlink": 4}


def test_a_time_of_receiving_of_zero_is_recognised_too(refused, written):
    rows = "".join(f"{10**6 + k},{0 if k == 3 else 10**6 + k + 5}\n" for k in range(9))
    text = refused(written("t.csv", "s(ms),r(ms)\n" + rows), "--columns", "sent=s,received=r")
    assert "line 5" in text
    assert "--lost 0" in text


def test_clocks_a_millisecond_apart_remain_a_matter_of_clocks(refused, written):
    rows = "".join(f"{k},{k % 4 - 1}\n" for k in range(20))
    text = refused(written("t.csv", "s(ms),d(ms)\n" + rows), "--columns", "sent=s,delay=d", *EACH)
    assert "--clock offset" in text


def test_delays_of_exactly_zero_are_told(convert, written):
    file = written("t.csv", "t_s,rtt_ms\n0,20\n0.05,0\n0.1,20\n")
    profile = convert(file, "--columns", "sent=t_s,rtt=rtt_ms")
    assert "1 of 3 rtt values are exactly 0; if lost, try --lost 0" in profile.metadata["notes"]


# Times as people write them --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "times", "sent"),
    [
        ("t", ["2023-11-14T22:13:20.00Z", "2023-11-14T22:13:20.05Z"], "t"),
        ("t", ["2023-11-14T22:13:20.00+01:00", "2023-11-14T21:13:20.05Z"], "t"),
        ("t", ["2023-11-14 22:13:20", "2023-11-14 22:13:20.050000000"], "t"),
        ("t", ["2023/11/14 22:13:20,00", "2023/11/14 22:13:20,05"], "t"),
        ("t", ["23:59:59.97", "00:00:00.02"], "t"),
        ("t", ["11/14/2023 10:13:20.97 PM", "11/14/2023 10:13:21.02 PM"], "t"),
        ("t", ["14.11.2023 23:59:59.97", "15.11.2023 00:00:00.02"], "t"),
        ("t", ["20231114T221320.97Z", "20231114T221321.02Z"], "t"),
        ("t", ["2023-11-14 22:13:20:970", "2023-11-14 22:13:21:020"], "t"),
        ("date;time", ["2023-11-14;22:13:20.97", "2023-11-14;22:13:21.02"], "date+time"),
        ("sec;nanosec", ["7;970000000", "8;20000000"], "sec+nanosec"),
        ("a.sec;a.nsec", ["7;970000000", "8;20000000"], "a.sec + a.nsec"),
        ("stampMs", ["970", "1020"], "stampMs"),
        ("Time (seconds)", ["0.97", "1.02"], "time"),
        ("time [millis]", ["970", "1020"], "time"),
        ("elapsed usec", ["970000", "1020000"], "elapsed usec"),
    ],
)
def test_times_are_read_as_people_write_them(convert, written, header, times, sent):
    text = f"{header};rtt_ms\n{times[0]};20\n{times[1]};21\n"
    profile = convert(written("t.csv", text), "--columns", f"sent={sent},rtt=rtt_ms", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_500_000]


def test_times_of_day_are_said(convert, written):
    text = "t rtt_ms\n23:59:59.97 20\n00:00:00.02 21\n"
    profile = convert(written("t.csv", text), "--columns", "sent=t,rtt=rtt_ms")
    assert any("times of day" in note for note in profile.metadata["notes"])


@pytest.mark.parametrize(
    "text",
    [
        *("2023-13-14 22:13:20", "22:13", "14.11.23 22:13:20"),
        *("0023-11-14 22:13:20", "9999-11-14 22:13:20"),
    ],
)
def test_a_time_that_is_none_is_refused_with_its_line(refused, written, text):
    file = written("t.csv", f"t,d_ms\n22:13:19,1\n{text},1\n")
    assert "line 3: expected sent as in 2023-11-14 22:13:20.5" in refused(
        file, "--columns", "sent=t,delay=d_ms", *EACH
    )


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_in_parquet_have_their_unit(convert, tmp_path, unit):
    per_s = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    stamps = pa.array([(1_700_000_000 + k) * per_s for k in range(3)], pa.timestamp(unit))
    trips = pa.array([20_000, None, 21_000], pa.duration("us"))
    parquet.write_table(pa.table({"t": stamps, "rtt": trips}), tmp_path / "t.parquet")
    profile = convert(tmp_path / "t.parquet", "--columns", "sent=t,rtt=rtt", "--period", "1s")
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, LOST, 10_500_000]


def test_parquet_without_columns_given_is_advised_by_its_schema(refused, tmp_path):
    stamps = pa.array([1_700_000_000], pa.timestamp("s"))
    parquet.write_table(pa.table({"ts": stamps, "rtt_ms": [20.0]}), tmp_path / "t.parquet")
    expected = "; it has ts, rtt_ms: try --columns 'sent=ts,rtt=rtt_ms'"
    assert refused(tmp_path / "t.parquet").endswith(expected)
    parquet.write_table(pa.table({"name": ["a"]}), tmp_path / "t.parquet")
    assert refused(tmp_path / "t.parquet").endswith("got none; it has name")


def test_times_that_step_back_are_told(convert, written):
    times = [*range(0, 500, 50), *range(250, 900, 50)]
    text = "t_ms,rtt_ms\n" + "".join(f"{t},20\n" for t in times)
    notes = convert(written("t.csv", text), "--columns", "sent=t_ms,rtt=rtt_ms").metadata["notes"]
    assert any(note.startswith("times step back 1 times, by 0.2 s at most") for note in notes)


def test_packets_that_share_times_are_told(convert, written):
    text = "t_s,rtt_ms\n" + "".join(f"{k // 10},{k}\n" for k in range(100))
    notes = convert(written("t.csv", text), "--columns", "sent=t_s,rtt=rtt_ms").metadata["notes"]
    assert any("100 packets have only 10 times of sending" in note for note in notes)
    text = "t_s,rtt_ms\n" + "".join(f"5,{k}\n" for k in range(9))
    notes = convert(written("t.csv", text), "--columns", "sent=t_s,rtt=rtt_ms").metadata["notes"]
    assert any("9 packets have only 1 time of sending" in note for note in notes)


def test_one_large_value_far_from_the_others_is_told(convert, written):
    rows = [20.5, 9999, 21, 9999, 22.5]

    def notes(rows, *flags):
        text = "t_s,rtt_ms\n" + "".join(f"{k / 20},{value}\n" for k, value in enumerate(rows))
        columns = ("--columns", "sent=t_s,rtt=rtt_ms")
        return "".join(convert(written("t.csv", text), *columns, *flags).metadata["notes"])

    assert "2 of 5 rtt values are exactly 9999, the next is 22.5; if lost, try --lost" in notes(
        rows
    )
    assert "exactly" not in notes(rows, "--lost", "9999")
    # One long delay, and a longest delay that is near the next, are delays.
    assert "exactly" not in notes([20.5, 300, 21]) + notes([20, 99, 99, 60])
    assert "exactly 20" not in notes([20, 0, 20, 0, 20])


def test_infinite_delays_are_lost(convert, written):
    file = written("t.csv", "t_s,rtt_ms\n0.00,20\n0.05,inf\n0.10,20\n")
    profile = convert(file, "--columns", "sent=t_s,rtt=rtt_ms", "--period", "50ms")
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, LOST, 10 * MS]
    table = pa.table({"t_s": [0.0, 0.05, 0.1], "rtt_ms": [20.0, float("inf"), 20.0]})
    parquet.write_table(table, file)
    profile = convert(file, "--columns", "sent=t_s,rtt=rtt_ms", "--period", "50ms")
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, LOST, 10 * MS]


@pytest.mark.parametrize(
    ("header", "asked", "words"),
    [
        ("t_s,rtt_ms,rtt_ms", "rtt_ms", "one column rtt_ms, got rtt_ms (column 2) and rtt_ms (col"),
        ("t_s,rtt(ms),rtt(us)", "rtt", "one column rtt, got rtt(ms) (column 2) and rtt(us) (col"),
    ],
)
def test_a_name_of_two_columns_is_refused(convert, refused, written, header, asked, words):
    file = written("t.csv", f"{header}\n0.00,20,30\n0.05,20,30\n")
    assert words in refused(file, "--columns", f"sent=t_s,rtt={asked}")
    other = "2(ms)" if asked == "rtt_ms" else "rtt(ms)"
    sent = "1(s)" if asked == "rtt_ms" else "t_s"
    profile = convert(file, "--columns", f"sent={sent},rtt={other}", "--period", "50ms")
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS] * 2


# Tables of other shapes ------------------------------------------------------------------------


def test_units_may_stand_behind_the_numbers_of_columns(convert, written):
    file = written("t.csv", "0.00,20\n0.05,21\n")
    profile = convert(file, "--columns", "sent=1(s),rtt=2(ms)", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_500_000]
    assert "a column 3(ms) (by number, from 1)" in refused_text(
        convert, file, "--columns", "sent=1(s),rtt=3(ms)"
    )


def refused_text(convert, *arguments):
    with pytest.raises(UserError) as error:
        convert(*arguments)
    return str(error.value)


@pytest.mark.parametrize(
    "text",
    [
        "A measurement\nof: a link, and more\n\nt_s,rtt_ms\n0.00,20\n0.05,21\n",
        "# t_s,rtt_ms\n0.00,20\n0.05,21\n",
        "\ufefft_s,rtt_ms,note\n0.00,20\n0.05,21,late\n",
        "t_s|rtt_ms\n0.00|20\n0.05|21\n",
    ],
    ids=["preamble", "comment", "BOM and ragged", "bars"],
)
def test_a_header_is_found_where_it_is(convert, written, text):
    file = written("t.csv", text)
    profile = convert(file, "--columns", "sent=t_s,rtt=rtt_ms", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_500_000]


def test_columns_may_be_counted_below_a_header(convert, written):
    file = written("t.csv", "of a link\nwhen,how long\n0.00,20\n0.05,21\n")
    profile = convert(file, "--columns", "sent=1(s),rtt=2(ms)", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_500_000]
    assert any("left out" in note for note in profile.metadata["notes"])
    message = refused_text(
        convert, written("u.csv", "0,1\n1,x\n"), "--columns", "sent=1(s),rtt=2(ms)"
    )
    assert "line 2: expected rtt as a number, got 'x'" in message


def test_delays_alone_are_an_interval_apart(convert, written):
    file = written("d.txt", "20\n21.5\nlost\n")
    profile = convert(
        file, "--columns", "rtt=1", "--unit", "ms", "--interval", "10ms", "--period", "10ms"
    )
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_750_000, LOST]


NEAR = "".join(f"{10**9 + k * 50 * MS},{k:04x}\n" for k in range(20))
FAR = "".join(f"{10**9 + k * 50 * MS + 4550},{k:04x}\n" for k in range(20) if k != 7)
JOIN = ("--columns", "time=1(ns),id=2")


def test_two_tables_are_joined_by_an_id(convert, written):
    files = written("near.csv", NEAR), written("far.csv", FAR + "9,strange\n")
    profile = convert(*files, *JOIN, *EACH)
    assert profile.delays_ns[UPLINK].tolist() == [LOST if k == 7 else 4550 for k in range(20)]
    assert profile.metadata["source"] == ["near.csv", "far.csv"]
    assert any("1 ids that only far.csv has" in note for note in profile.metadata["notes"])
    answers = written("far2.csv", FAR), written("near2.csv", NEAR)
    profile = convert(*files[:1], written("f.csv", FAR), *answers, *JOIN, "--clock", "offset")
    assert profile.metadata["packets"] == {"uplink": 20, "downlink": 19}


def test_tables_with_an_id_may_have_names_of_their_own(convert, written):
    near, far = (
        written("n.csv", "seq,tx_ns\n" + swapped(NEAR)),
        written("f.csv", "rx_ns,seq\n" + FAR),
    )
    profile = convert(near, far, "--columns", "sent=tx_ns,received=rx_ns,id=seq", *EACH)
    assert profile.delays_ns[UPLINK].tolist() == [LOST if k == 7 else 4550 for k in range(20)]


def swapped(rows):
    return "".join(",".join(reversed(row.split(","))) + "\n" for row in rows.splitlines())


@pytest.mark.parametrize(
    ("near", "far", "columns", "words"),
    [
        (NEAR + "5,0003\n", FAR, JOIN, "line 21: expected an id that no other row has, got '0003'"),
        (NEAR, "7,x\n", JOIN, "the same ids in both, got none"),
        (NEAR, FAR, ("--columns", "rtt=1(ns),id=2"), "a time and an id"),
    ],
)
def test_tables_that_cannot_be_joined_are_refused(refused, written, near, far, columns, words):
    files = written("n.csv", near), written("f.csv", far)
    assert words in refused(*files, *columns, *EACH)
    assert "got 1 files" in refused(files[0], *columns)


def test_milliseconds_taken_for_seconds_are_refused_as_hours(refused, written):
    text = "t,d\n" + "".join(f"{1721808645000 + 50 * k},4000\n" for k in range(100))
    columns = ("--columns", "sent=t,delay=d", "--other-way", "same")
    assert "units" in refused(written("t.csv", text), *columns, "--unit", "s")


def test_a_lost_packet_is_no_new_day(convert, written):
    # The sender's times pass midnight after the receiver's first.
    rows = ["59.90,23:59:59.93", "59.95,", "59.99,00:00:00.02"]
    text = "tx,rx\n" + "".join(f"23:59:{row}\n" for row in rows) + "00:00:00.05,00:00:00.08\n"
    profile = convert(written("t.csv", text), "--columns", "sent=tx,received=rx", *EACH)
    assert profile.delays_ns[UPLINK].tolist() == [30 * MS, LOST, 30 * MS, 30 * MS]


def test_a_cell_may_have_its_unit(convert, written):
    file = written("t.csv", "t,rtt\n0 s,20 ms\n50ms,timeout\n0.1s,20000us\n")
    profile = convert(file, "--columns", "sent=t,rtt=rtt", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, LOST, 10 * MS]


def test_a_row_of_units_may_stand_below_the_header(convert, written):
    file = written("t.csv", "t,rtt,note\n[s],(ms),\n0,20,a\n0.05,21,b\n")
    profile = convert(file, "--columns", "sent=t,rtt=rtt", *EACH[:2])
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 10_500_000]


ARRIVED = [0, 1, 3, 4, 6, 7, 8, 9, 12, 13]


@pytest.mark.parametrize("first", [7, 250, 65530])
def test_numbers_that_skip_tell_what_is_lost(convert, written, tmp_path, first):
    wrap = 256 if first == 250 else 65536
    rows = [((first + k) % wrap, 50 * k, 50 * k + 20) for k in ARRIVED]
    asked = ("--columns", "sent=tx_ms,received=rx_ms,seq=seq", *EACH)
    expected = [20 * MS if k in ARRIVED else LOST for k in range(14)]
    text = "seq,tx_ms,rx_ms\n" + "".join(f"{n},{sent},{received}\n" for n, sent, received in rows)
    profile = convert(written("t.csv", text), *asked)
    assert profile.delays_ns[UPLINK].tolist() == expected
    assert "4 packets lost by their numbers (seq)" in profile.metadata["notes"]
    columns = dict(zip(("seq", "tx_ms", "rx_ms"), zip(*rows, strict=True), strict=True))
    parquet.write_table(pa.table({k: list(v) for k, v in columns.items()}), tmp_path / "t.parquet")
    assert convert(tmp_path / "t.parquet", *asked).delays_ns[UPLINK].tolist() == expected


def test_delays_with_numbers_need_no_times(convert, written):
    text = "seq,rtt_ms\n" + "".join(f"{k},20\n" for k in ARRIVED)
    asked = ("--columns", "rtt=rtt_ms,seq=seq", "--interval", "50ms", *EACH[:2])
    delays = convert(written("t.csv", text), *asked).delays_ns[UPLINK].tolist()
    assert delays == [10 * MS if k in ARRIVED else LOST for k in range(14)]


def test_a_column_of_numbers_that_skip_is_told(convert, written):
    rows = "".join(f"{k},{50 * k},20\n" for k in ARRIVED)
    asked = ("--columns", "sent=t_ms,rtt=rtt_ms")
    notes = convert(written("t.csv", "seq,t_ms,rtt_ms\n" + rows), *asked).metadata["notes"]
    assert (
        "the numbers in seq skip 4 of 14 packets; if these were lost, add seq=seq to --columns"
        in notes
    )
    for rows in ("".join(f"{k},{50 * k},20\n" for k in range(9)), "5,0,20\n5,50,20\n9,100,20\n"):
        notes = convert(written("t.csv", "seq,t_ms,rtt_ms\n" + rows), *asked).metadata["notes"]
        assert not any("skip" in note for note in notes)


@pytest.mark.parametrize("number", ["1.5", "x", "-3"])
def test_a_number_of_a_packet_is_whole(refused, written, number):
    text = refused(written("t.csv", f"n,t_ms,rtt_ms\n{number},0,20\n"),
                   "--columns", "sent=t_ms,rtt=rtt_ms,seq=n")  # fmt: skip
    assert "line 2: expected seq as a whole number" in text


def test_a_wrong_unit_of_time_is_told_by_the_number_of_packets_in_a_period(convert, written):
    text = "t,rtt\n" + "".join(f"{k / 50},20\n" for k in range(500))
    profile = convert(written("t.csv", text), "--columns", "sent=t,rtt=rtt", "--unit", "ms")
    words = "500 packets in 10 periods, and of each the longest delay counts; is the unit of the"
    assert any(words in note for note in profile.metadata["notes"])


def test_rows_of_several_ways_or_hosts_are_told(convert, written, tmp_path):
    rows = "".join(f"{50 * k},{'ul' if k % 2 else 'dl'},20\n" for k in range(8))
    asked = ("--columns", "sent=t_ms,delay=d_ms", *EACH)
    notes = convert(written("t.csv", "t_ms,Direction,d_ms\n" + rows), *asked).metadata["notes"]
    words = (
        "the column Direction has 2 values (dl, ul), and their rows are taken together; give a file"
    )
    assert any(note.startswith(words) for note in notes)
    table = pa.table({"t_ms": [0, 50], "d_ms": [20, 20], "host": ["a", "b"]})
    parquet.write_table(table, tmp_path / "t.parquet")
    notes = convert(tmp_path / "t.parquet", *asked).metadata["notes"]
    assert any("the column host has 2 values (a, b)" in note for note in notes)
    one = convert(written("t.csv", "t_ms,host,d_ms\n0,a,20\n50,a,20\n"), *asked).metadata["notes"]
    assert not any("taken together" in note for note in one)
