"""The recorder's messages and its two ends: what they refuse, and that reports come home."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.recorder.clock_offset import NEVER
from netem.recorder.probe import (
    MAX_BYTES,
    MIN_BYTES,
    REPORTS,
    VERSION,
    DownProbe,
    Instant,
    ProbeSettings,
    UpProbe,
    decode_down,
    decode_up,
    encode_down,
    encode_up,
    pack_report,
    parse_bytes,
    version_notice,
)
from netem.recorder.probe_far import FarEnd
from netem.recorder.probe_near import NearEnd
from shared.errors import ConfigError, MessageRefused

MS = 1_000_000
SECOND = 1_000_000_000
SETTINGS = ProbeSettings(period_ns=MS, uplink_bytes=100, downlink_bytes=MIN_BYTES)
U32 = st.integers(0, 2**32 - 1)
STAMP = st.integers(0, 2**63 - 1)


def at(time_ns):
    return Instant(time_ns, time_ns)


def make_near(session=1, capacity=1000):
    return NearEnd(SETTINGS, session=session, capacity=capacity)


@given(U32, U32, STAMP, st.booleans(), U32, st.integers(MIN_BYTES, 2000), st.booleans())
def test_a_message_up_comes_back_from_its_bytes(
    session, sequence, sent_ns, draining, acknowledged, size, synchronised
):
    settings = ProbeSettings(MS, size, 40_000, synchronised)
    probe = UpProbe(session, sequence, sent_ns, draining, acknowledged, settings)
    data = encode_up(probe, size=size)
    assert len(data) == size
    assert decode_up(data) == probe


@given(U32, U32, STAMP, st.booleans(), U32, st.lists(st.tuples(U32, STAMP), max_size=5))
def test_a_message_down_comes_back_from_its_bytes(
    session, sequence, sent_ns, draining, first, reports
):
    packed = b"".join(pack_report(*report) for report in reports)
    probe = DownProbe(session, sequence, sent_ns, draining, first, packed)
    data = encode_down(probe, size=500)
    assert len(data) == 500
    assert decode_down(data) == probe
    assert np.frombuffer(packed, REPORTS).tolist() == reports


@given(st.binary(max_size=200) | st.binary(max_size=60).map(lambda data: b"WBCd\1\0" + data))
def test_junk_is_refused_and_counted_and_changes_nothing(data):
    near, far = make_near(), FarEnd()
    near.message(at(0))
    near.take(data, at(0), one_clock=True)
    far.take(data, at(0))
    assert near.refused.total_refused == far.refused.total_refused == 1
    assert not near.answered
    assert far.recording is None


def test_either_end_names_another_version():
    data = encode_up(UpProbe(1, 0, 0, False, 0, SETTINGS), size=100)
    far = FarEnd()
    far.take(data[:4] + (VERSION + 1).to_bytes(2, "little") + data[6:], at(0))
    assert far.owes_version
    near = make_near()
    notice = version_notice()
    near.take(notice[:4] + (VERSION + 1).to_bytes(2, "little"), at(0), one_clock=True)
    assert near.other_version == f"version: expected {VERSION}, got {VERSION + 1}"


def test_a_far_end_refuses_settings_it_could_not_send_by():
    far = FarEnd()
    for period_ns, size in ((0, 1000), (MS, 1), (MS, 2 * MAX_BYTES)):
        settings = ProbeSettings(period_ns, 100, size)
        far.take(encode_up(UpProbe(1, 0, 0, False, 0, settings), size=100), at(0))
    assert far.refused == {"settings": 3}


def test_what_arrived_is_reported_until_it_is_acknowledged_with_few_reports_per_message():
    near, far = make_near(), FarEnd()
    for k in range(10):
        far.take(near.message(at(k * MS)), at((k + 5) * MS))
    # Four reports fit into a message, so that three carry all; every fourth message is lost.
    for k in range(9):
        data = far.recording.message(at((20 + k) * MS))
        if k % 4 != 1:
            near.take(data, at((30 + k) * MS), one_clock=True)
    up, _ = near.stamps()
    assert np.array_equal(up.received_ns, (np.arange(10) + 5) * MS)
    # All are acknowledged by the next message up, whose own report is then the only one.
    far.take(near.message(at(40 * MS)), at(45 * MS))
    down = decode_down(far.recording.message(at(50 * MS)))
    assert (down.first_report, down.reports) == (10, pack_report(10, 45 * MS))
    # Draining makes room for all that is left, and ends when nothing is missing.
    near.draining = True
    far.take(near.message(at(100 * MS)), at(105 * MS))
    near.take(far.recording.message(at(110 * MS)), at(115 * MS), one_clock=True)
    up, down = near.stamps()
    assert np.all(up.received_ns != NEVER)
    assert np.count_nonzero(down.received_ns == NEVER) == 3
    assert near.drained
    assert not near.complete


def test_a_message_up_that_never_arrived_leaves_a_recording_incomplete():
    near, far = make_near(), FarEnd()
    far.take(near.message(at(0)), at(MS))
    near.message(at(MS))
    near.take(far.recording.message(at(2 * MS)), at(3 * MS), one_clock=True)
    near.draining = True
    for k in range(4, 8):
        far.take(near.message(at(k * MS)), at(k * MS))
        near.take(far.recording.message(at(k * MS)), at(k * MS), one_clock=True)
    assert near.drained
    assert not near.complete
    assert near.stamps()[0].received_ns.tolist() == [MS, NEVER]


def test_memory_of_the_near_end_is_bounded():
    near, far = make_near(capacity=3), FarEnd()
    far.take(near.message(at(0)), at(MS))
    for k in range(5):
        near.take(far.recording.message(at(k * MS)), at((k + 1) * MS), one_clock=True)
    assert near.refused == {"sequence": 2}
    assert len(near.stamps()[1].sent_ns) == 3


def test_a_repeated_message_counts_once():
    near, far = make_near(), FarEnd()
    up = near.message(at(0))
    far.take(up, at(MS))
    far.take(up, at(2 * MS))
    down = far.recording.message(at(3 * MS))
    near.take(down, at(4 * MS), one_clock=True)
    near.take(down, at(9 * MS), one_clock=True)
    first, second = near.stamps()
    assert first.received_ns.tolist() == [MS]
    assert second.received_ns.tolist() == [4 * MS]
    assert near.refused == {"duplicate": 1}


def test_reports_of_messages_that_were_never_sent_are_refused():
    near = make_near()
    near.message(at(0))
    probe = DownProbe(1, 0, 0, False, 0, pack_report(5, 0))
    near.take(encode_down(probe, size=0), at(0), one_clock=True)
    assert near.refused == {"reports": 1}
    assert not near.answered


def test_a_second_recorder_waits_until_the_first_has_left():
    first, second, far = make_near(1), make_near(2), FarEnd()
    far.take(first.message(at(0)), at(0))
    far.take(second.message(at(SECOND)), at(SECOND))
    assert far.recording.session == 1
    assert far.refused == {"busy": 1}
    # It sees the other's answers and knows why there is none for it.
    second.take(far.recording.message(at(SECOND)), at(SECOND), one_clock=True)
    assert second.refused == {"session": 1}
    far.take(second.message(at(3 * SECOND)), at(3 * SECOND))
    assert far.recording.session == 2


def test_a_late_message_does_not_begin_a_recording_again():
    near, far = make_near(), FarEnd()
    data = near.message(at(0))
    far.take(data, at(0))
    far.end()
    far.take(data, at(SECOND))
    assert far.recording is None
    assert far.refused == {"late": 1}


def test_a_far_end_outlasts_an_outage_but_not_a_drained_recording():
    near, far = make_near(), FarEnd()
    far.take(near.message(at(0)), at(0))
    assert not far.recording.over(at(30 * SECOND))
    assert far.recording.over(at(61 * SECOND))
    near.draining = True
    far.take(near.message(at(SECOND)), at(SECOND))
    assert far.recording.over(at(4 * SECOND))


@pytest.mark.parametrize(
    ("text", "size"), [("1000B", 1000), ("40kB", 40_000), ("1200", 1200), (" 2 kB", 2000)]
)
def test_a_size_is_bytes(text, size):
    assert parse_bytes(text, option="uplink") == size


@pytest.mark.parametrize("text", ["", "10", "2MB", "-5B", "1.5kB", "99999999B", "1000b"])
def test_a_wrong_size_is_named(text):
    with pytest.raises(ConfigError, match="uplink: expected a size from"):
        parse_bytes(text, option="uplink")


def test_the_opening_of_a_refused_length_is_checked_first():
    with pytest.raises(MessageRefused) as refusal:
        decode_up(version_notice())
    assert refusal.value.reason == "stranger"
