from __future__ import annotations

import pyarrow as pa
import pytest
from pyarrow import parquet

from netem.profile import DOWNLINK, LOST, UPLINK

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
    [(["a", "b"], "numbers"), ([float("nan"), 1.0], "finite"), ([1e300, 1.0], "finite")],
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
        ("5,nan", "delay as a number, got 'nan'"),
        ("5,inf", "delay as a number, got 'inf'"),
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
        (("--columns", "sent=t"), "expected sent=NAME and received="),
        (("--columns", "sent=t,size=d"), "expected sent=NAME and received="),
        (("--columns", "sent=t,uplink=d"), "both uplink= and downlink="),
        (("--columns", "sent=t,delay=e"), "its unit in its name"),
        (("--columns", "sent=t,delay=e", "--unit", "h"), "its unit in its name"),
        (("--columns", "sent"), "expected columns as in"),
    ],
)
def test_columns_that_say_too_little_are_refused(refused, written, columns, words):
    file = written("t.csv", "t(s),d(ms),e\n1,2,3\n")
    assert words in refused(file, *columns, "--other-way", "same")


def test_milliseconds_taken_for_seconds_are_refused_as_hours(refused, written):
    text = "t,d\n" + "".join(f"{1721808645000 + 50 * k},4000\n" for k in range(100))
    columns = ("--columns", "sent=t,delay=d", "--other-way", "same")
    assert "units" in refused(written("t.csv", text), *columns, "--unit", "s")
