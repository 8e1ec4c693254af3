from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.importers.mahimahi import read_mahimahi
from netem.importers.options import Load, Options
from netem.profile import DOWNLINK, LOST, UPLINK

MS = 1_000_000


def queue_by_bytes(trace, sent_ms, size, bound):
    """Delay of each message [ms], None if lost: a queue emptied byte by byte, 1500 at a time."""
    cycle = trace[-1]
    queue: deque[list[int]] = deque()
    delays: list[int | None] = [None] * len(sent_ms)
    arrivals = deque(enumerate(sent_ms))
    backlog, now = 0, 0
    while arrivals or queue:
        # The opportunities of a millisecond come before what is sent in it.
        for base in {now // cycle * cycle, (now // cycle - 1) * cycle}:
            for _ in range(trace.count(now - base) if base >= 0 else 0):
                room = 1500
                while queue and room:
                    taken = min(room, queue[0][1])
                    room, backlog = room - taken, backlog - taken
                    queue[0][1] -= taken
                    if not queue[0][1]:
                        m = queue.popleft()[0]
                        delays[m] = now - sent_ms[m]
        while arrivals and arrivals[0][1] == now:
            m, _ = arrivals.popleft()
            if not backlog or backlog + size <= bound:
                queue.append([m, size])
                backlog += size
        now += 1
    return delays


@given(
    gaps=st.lists(st.integers(0, 4), min_size=1, max_size=30),
    size=st.integers(1, 9000),
    bound=st.integers(1, 20_000),
)
def test_delays_are_those_of_a_queue_emptied_byte_by_byte(tmp_path_factory, gaps, size, bound):
    trace = np.cumsum(gaps).tolist()
    trace[-1] = max(trace[-1], 1)
    path = tmp_path_factory.mktemp("trace") / "a.up"
    path.write_text("".join(f"{time}\n" for time in trace))
    options = Options(
        load=(Load(size, 1000.0), Load(1, 1.0)), queue_bytes=bound, duration_ns=40 * MS
    )
    way = read_mahimahi(path, options, UPLINK).ways[UPLINK]
    expected = queue_by_bytes(trace, list(range(40)), size, bound)
    assert way.sent_ns.tolist() == [k * MS for k in range(40)]
    assert way.lost.tolist() == [delay is None for delay in expected]
    assert way.delay_ns.tolist() == [0 if delay is None else delay * MS for delay in expected]


def test_a_trace_of_each_way_has_its_load_its_delay_and_its_capacity(convert, written):
    up, down = written("a.up", "1\n2\n4\n"), written("a.down", "1\n1\n1\n2\n2\n5\n5\n5\n5\n")
    profile = convert(
        *(up, down, "--load", "1500B@1kHz/3000B@1kHz", "--base-delay", "2ms/3ms"),
        *("--duration", "6ms"),
    )
    # Up, cycle 4: opportunities at 1 2 4 5 6 8 9 10 12; down, cycle 5: two or more at 1 1 1 2 2 5 5
    # 5 5 6 6 6 7 7 10 …, the third one at 1 ms finding nothing.
    assert (profile.delays_ns[UPLINK] // MS).tolist() == [
        left - sent + 2 for sent, left in enumerate([1, 2, 4, 5, 6, 8])
    ]
    assert (profile.delays_ns[DOWNLINK] // MS).tolist() == [
        left - sent + 3 for sent, left in enumerate([1, 2, 5, 5, 6, 7])
    ]
    opportunities_up = [0, 1, 1, 0, 1, 1]
    opportunities_down = [0, 3, 2, 0, 0, 4]
    for way, counts in (("uplink", opportunities_up), ("downlink", opportunities_down)):
        assert profile.columns[f"{way}_capacity_bytes"].tolist() == [1500 * n for n in counts]
    assert profile.metadata["downlink_bytes"] == 3000
    assert profile.metadata["rate_hz"] == 1000


def test_a_way_is_told_by_the_ending_of_its_trace(refused, written):
    up, down = written("a.up", "1\n"), written("a.down", "1\n")
    assert "uplink first" in refused(down, up, "--load", "1B@1Hz")


def test_the_same_trace_may_serve_both_ways_each_with_its_own_load(convert, written):
    trace = written("trace", "1\n")
    profile = convert(
        *(trace, "--other-way", "same", "--load", "1500B@500Hz/3000B@500Hz"),
        *("--duration", "10ms", "--period", "2ms"),
    )
    assert profile.delays_ns.tolist() == [[MS] * 5, [2 * MS] * 5]


def test_a_full_queue_loses_what_comes(convert, written):
    trace = written("trace", "10\n")
    profile = convert(
        *(trace, "--other-way", "same", "--load", "1500B@1kHz", "--queue", "3kB"),
        *("--duration", "10ms"),
    )
    assert profile.delays_ns[UPLINK].tolist() == [10 * MS, 19 * MS] + [LOST] * 8


def test_a_trace_without_a_load_is_refused_with_how_to_give_one(refused, written):
    text = refused(written("trace", "1\n2\n"))
    assert "--load 1000B@500Hz/1000B@1kHz" in text
    assert "--columns 'rtt=1(ms)' --interval 10ms" in text


@pytest.mark.parametrize(("size", "above"), [(1000, False), (2000, True)])
def test_a_load_above_what_the_trace_carries_is_warned_about(convert, written, size, above):
    trace = written("trace", "".join(f"{k}\n" for k in range(1, 1001)))
    load = ("--load", f"{size}B@1kHz", "--other-way", "same")
    notes = convert(trace, *load).metadata["notes"]
    words = f"the load is {size * 0.008:.3g} Mbit/s, the mean of the trace is 12 Mbit/s"
    told = [note for note in notes if words in note]
    assert len(told) == 2
    assert all(("warning" in note) == above for note in told)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "1\n2\nx\n",
            "line 3: expected one time in whole ms, from the last line's 2 to 10000000, got 'x'",
        ),
        ("1\n3\n2\n", "line 3: expected one time in whole ms, from the last line's 3"),
        ("1\n-2\n", "line 2: expected one time in whole ms"),
        ("1\n2.5\n", "line 2: expected one time in whole ms"),
        ("1\n99999999999\n", "line 2"),
        ("0\n0\n", "later than 0"),
        ("", "later than 0"),
    ],
)
def test_a_wrong_line_of_a_trace_is_named(refused, written, text, words):
    file = written("a.trace", text)
    message = refused(file, "--format", "mahimahi", "--other-way", "same", "--load", "1B@1Hz")
    assert words in message


TRAINS = "0 20 0 0 1 1 2\n10 30 0 1 1 2 3\n20 20 0 2 2 2 2\n"


def test_blanks_and_comments_around_a_trace_do_not_matter(convert, written):
    plain, other = written("a", "1\n1\n3\n"), written("b", "# of a drive\r\n 1 \r\n1\r\n\r\n3")
    load = ("--other-way", "same", "--load", "1500B@1kHz", "--duration", "9ms")
    assert convert(plain, *load).delays_ns.tolist() == convert(other, *load).delays_ns.tolist()


def test_a_train_delays_a_message_by_its_last_packet(convert, written):
    file = written("train", TRAINS)
    first = convert(file, "--other-way", "same", "--period", "10ms")
    assert first.delays_ns[UPLINK].tolist() == [20 * MS, 30 * MS, 20 * MS]
    # 4000 bytes are three packets of 1400; of nine, four more than there are, at the train's pace.
    profile = convert(
        *(file, "--other-way", "same", "--period", "10ms", "--load", "4000B@1kHz/12600B@1kHz")
    )
    assert profile.delays_ns[UPLINK].tolist() == [21 * MS, 31 * MS, 22 * MS]
    assert profile.delays_ns[DOWNLINK].tolist() == [24 * MS, 36 * MS, 24 * MS]
    assert any("trains are shorter" in note for note in profile.metadata["notes"])


def test_between_trains_the_base_delay_changes_gradually(convert, written):
    profile = convert(written("train", TRAINS), "--other-way", "same")
    assert profile.delays_ns[UPLINK, :11].tolist() == [(20 + k) * MS for k in range(11)]


@pytest.mark.parametrize(
    ("line", "words"),
    [("30 20", "the train's arrivals"), ("5 20 0", "not before"), ("30 -20 0", "milliseconds")],
)
def test_a_wrong_train_is_named_with_its_line(refused, written, line, words):
    file = written("train", TRAINS + line + "\n")
    message = refused(file, "--format", "cellreplay", "--other-way", "same")
    assert "line 4" in message
    assert words in message
