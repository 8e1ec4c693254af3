from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from netem.importers.measured import Measured, Series, ordered, without_unfinished
from netem.importers.options import Options
from netem.importers.resample import MAX_PERIODS, to_profile
from netem.profile import DOWNLINK, LOST, UPLINK
from shared.errors import ProfileError

MS = 1_000_000


def profile_of(up, down=None, *, period_ns=MS, series=None, **options):
    """Of (sent_ns, delay_ns or LOST) of each way; the downlink is 1 ms throughout if not given."""
    ways = [
        None
        if way is None
        else ordered([s for s, _ in way], [d for _, d in way], [d == LOST for _, d in way])
        for way in (up, down)
    ]
    measured = Measured((ways[0], ways[1]), series=series or {})
    constant_ns = MS if down is None else None
    chosen = Options(period_ns=period_ns, **options)
    return to_profile(measured, chosen, name="test", constant_ns=constant_ns)


def test_a_period_has_the_longest_delay_of_its_packets():
    burst = [(k * MS + j * 1000, (j % 3) * MS + 7) for k in range(4) for j in range(5)]
    assert profile_of(burst).delays_ns[UPLINK].tolist() == [2 * MS + 7] * 4


def test_a_period_is_lost_only_if_all_its_packets_were():
    packets = [(0, MS), (10, LOST), (MS, LOST), (MS + 10, LOST), (2 * MS, MS)]
    assert profile_of(packets).delays_ns[UPLINK].tolist() == [MS, LOST, MS]


def test_behind_a_stall_the_packets_that_were_not_measured_wait_a_millisecond_less_each():
    # Sent every 20 ms into a stall that ends at 100 ms: each waits until then.
    packets = [(sent * MS, (100 - sent) * MS) for sent in range(0, 100, 20)]
    expected = [(100 - sent) * MS for sent in range(81)]
    assert profile_of(packets).delays_ns[UPLINK].tolist() == expected


def test_a_lost_packet_is_no_delay_to_interpolate_from():
    packets = [(0, 2 * MS), (2 * MS, LOST), (4 * MS, 4 * MS)]
    delays = profile_of(packets).delays_ns[UPLINK].tolist()
    assert delays == [2 * MS, 2 * MS, LOST, LOST, 4 * MS]


def test_between_two_lost_packets_all_is_lost():
    packets = [(0, MS), (3 * MS, LOST), (6 * MS, LOST), (9 * MS, 2 * MS)]
    delays = profile_of(packets).delays_ns[UPLINK].tolist()
    assert delays == [MS] * 3 + [LOST] * 6 + [2 * MS]


def test_a_packet_lost_at_the_end_stands_as_long_as_packets_are_apart():
    packets = [(0, MS), (5 * MS, MS), (10 * MS, LOST)]
    delays = profile_of(packets).delays_ns[UPLINK].tolist()
    assert delays == [MS] * 10 + [LOST] * 5


def test_a_lone_loss_may_stand_for_its_own_period_only():
    sent = {0: MS, 3: LOST, 6: MS, 9: LOST, 12: LOST, 15: MS}
    packets = [(at * MS, delay) for at, delay in sent.items()]
    profile = profile_of(packets, lone_loss="period")
    assert profile.delays_ns[UPLINK].tolist() == ([MS] * 3 + [LOST] + [MS] * 5 + [LOST] * 6 + [MS])
    assert any("--lone-loss" in note for note in profile.metadata["notes"])


def test_packets_of_which_only_some_are_lost_in_every_period_are_told():
    packets = [(k * MS // 10, LOST if k % 5 == 0 else MS) for k in range(1000)]
    profile = profile_of(packets)
    assert LOST not in profile.delays_ns[UPLINK]
    assert any("shorter --period" in note for note in profile.metadata["notes"])


PAUSE = [(k * 10 * MS, 20 * MS) for k in range(50)]
PAUSE += [(t + 600_000 * MS, d) for t, d in PAUSE]


def test_a_pause_is_refused_with_its_place_and_its_length():
    with pytest.raises(ProfileError) as error:
        profile_of(PAUSE)
    for word in ("599.5 s without uplink packets", "0.5 s after the first", "--pause cut"):
        assert word in str(error.value)


def test_a_pause_is_cut_out_of_both_ways_and_of_what_else_was_measured():
    # The other way and the bytes go on; a number of µs more, the packets keep their phase.
    up = [(t + 3000 * (t > 1000 * MS), d) for t, d in PAUSE]
    down = [(k * 100 * MS, k * 1000) for k in range(6006)]
    at = np.arange(0, 600_500 * MS, MS)
    series = {"uplink_capacity_bytes": Series(at, at / MS)}
    profile = profile_of(up, down, series=series, pause="cut")
    n = profile.delays_ns.shape[1]
    assert n == 991
    assert set(profile.delays_ns[UPLINK].tolist()) == {20 * MS}
    assert profile.delays_ns[DOWNLINK][[0, 400]].tolist() == [0, 4000]
    # From 600 s on, where the uplink begins again.
    assert profile.delays_ns[DOWNLINK][[600, 900]].tolist() == [6_001_000, 6_004_000]
    assert profile.columns["uplink_capacity_bytes"][[0, 499, -1]].tolist() == [0, 499, 600_490]
    assert any(note.startswith("cut out: 599.5") for note in profile.metadata["notes"])
    assert profile.metadata["packets"]["uplink"] == 100


def test_a_pause_may_be_taken_as_lost():
    profile = profile_of(PAUSE, pause="lost")
    lost = profile.delays_ns[UPLINK] == LOST
    assert lost[:501].sum() == 1
    assert lost.sum() == 599_500
    assert profile.metadata["packets"]["uplink"] == 100
    assert profile.metadata["packets_lost"]["uplink"] == 0


def test_packets_far_apart_as_always_make_no_pause():
    packets = [(k * 2000 * MS, k * MS) for k in range(5)]
    assert profile_of(packets).delays_ns[UPLINK].max() == 4 * MS


@given(
    stretches=st.lists(st.integers(1, 400), min_size=3, max_size=20),
    spacing=st.integers(1, 120),
    first=st.integers(0, 119),
    dead=st.booleans(),
)
def test_what_is_lost_and_how_long_is_as_it_was_to_within_the_time_between_packets(
    stretches, spacing, first, dead
):
    # The truth of each millisecond: the link is up and dead by turns.
    truth = np.concatenate([np.full(n, dead ^ bool(k % 2)) for k, n in enumerate(stretches)])
    sent = np.arange(min(first, spacing - 1), len(truth), spacing)
    assume(len(sent) > 2 and not truth[sent].all())
    packets = [(int(t) * MS, LOST if truth[t] else 2 * MS) for t in sent]
    lost = profile_of(packets).delays_ns[UPLINK] == LOST
    seen = truth[sent[0] : sent[-1] + 1]
    changes = 1 + np.count_nonzero(np.diff(seen))
    assert abs(int(lost[: len(seen)].sum()) - int(seen.sum())) <= spacing * changes
    # Of the packets exactly as many are lost as of the time.
    covered = sent[-1] + spacing * truth[sent[-1]] - sent[0]
    assert lost[:covered].sum() == spacing * truth[sent].sum()
    # Every outage that two packets met is there, as long as it was.
    for begin, end in outages_of(seen):
        inside = (sent - sent[0] >= begin) & (sent - sent[0] < end)
        if inside.sum() < 2 or begin == 0 or end == len(seen):
            continue
        at = int(sent[inside][0] - sent[0])
        length = next((b - a for a, b in outages_of(lost) if a <= at < b))
        merged = truth[sent][np.searchsorted(sent - sent[0], [begin, end]) - [1, 0]].any()
        assert merged or abs(length - (end - begin)) < spacing


def outages_of(lost):
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    return edges.reshape(-1, 2).tolist()


@pytest.mark.parametrize("early_ns", [-400, -1, 0, 1, 400])
def test_times_rounded_either_way_stay_in_their_period(early_ns):
    packets = [(k * MS + early_ns * (-1) ** k, k * 1000) for k in range(50)]
    assert profile_of(packets).delays_ns[UPLINK].tolist() == [k * 1000 for k in range(50)]


def test_the_ways_share_the_time_for_which_both_were_measured():
    up = [(k * MS, k * 1000) for k in range(10)]
    down = [(k * MS + 300_000, k * 1000) for k in range(4, 20)]
    profile = profile_of(up, down)
    assert profile.delays_ns[UPLINK].tolist() == [k * 1000 for k in range(4, 10)]
    assert profile.delays_ns[DOWNLINK].tolist() == [k * 1000 for k in range(4, 10)]
    assert any("all files cover" in note for note in profile.metadata["notes"])


def test_ways_measured_on_different_days_are_taken_from_their_start():
    day_ns = 86_400_000_000_000
    up = [(k * MS, k * 1000) for k in range(5)]
    down = [(day_ns + 123 + k * MS, k * 2000) for k in range(5)]
    profile = profile_of(up, down)
    assert profile.delays_ns.tolist() == [[0, 1000, 2000, 3000, 4000], [0, 2000, 4000, 6000, 8000]]
    assert any("different times" in note for note in profile.metadata["notes"])


def test_bytes_are_added_up_and_means_are_taken_in_each_period():
    packets = [(k * MS, MS) for k in range(3)]
    at = np.array([0, 100, 2 * MS])
    series = {
        "uplink_capacity_bytes": Series(at, np.array([1000.0, 500.0, 7.0])),
        "sinr_ul_db": Series(at, np.array([10.0, 20.0, -3.0]), mean=True),
    }
    columns = profile_of(packets, series=series).columns
    assert columns["uplink_capacity_bytes"].tolist() == [1500, 0, 7]
    assert columns["sinr_ul_db"][[0, 2]].tolist() == [15.0, -3.0]
    assert np.isnan(columns["sinr_ul_db"][1])


def test_a_period_of_another_length_holds_more_packets():
    packets = [(k * MS, k * 1000) for k in range(20)]
    profile = profile_of(packets, period_ns=5 * MS)
    assert profile.period_ns == 5 * MS
    # Nothing was sent between 19 and 24 ms: there the boundary lies.
    assert profile.delays_ns[UPLINK].tolist() == [4000, 9000, 14000, 19000]


@given(
    gaps=st.lists(st.integers(1, 5 * MS), min_size=1, max_size=40),
    origin=st.integers(-(10**15), 2 * 10**18),
    data=st.data(),
)
def test_delays_are_those_of_packets_or_between_them_and_arrivals_keep_their_order(
    gaps, origin, data
):
    sent = origin + np.cumsum(gaps)
    # A FIFO link: nobody overtakes.
    arrivals = np.maximum.accumulate(
        [s + data.draw(st.integers(0, 50 * MS)) for s in sent.tolist()]
    )
    packets = list(zip(sent.tolist(), (arrivals - sent).tolist(), strict=True))
    delays = profile_of(packets).delays_ns[UPLINK]
    assert min(d for _, d in packets) <= delays.min()
    assert delays.max() == max(d for _, d in packets)
    # A message sent a period later arrives no earlier than a period before the last one did.
    assert (np.diff(delays) >= -2 * MS).all()


@pytest.mark.parametrize(
    ("packets", "words"),
    [
        ([(0, LOST), (MS, LOST)], ["uplink", "arrived"]),
        ([(0, MS), (MAX_PERIODS * MS, MS)], ["units", "--period"]),
        ([(0, 3600 * 1000 * MS + 1)], ["3600 s", "units"]),
        ([(0, -5)], ["from 0"]),
    ],
    ids=["all lost", "too long", "hours of delay", "negative"],
)
def test_what_makes_no_profile_is_refused(packets, words):
    with pytest.raises(ProfileError) as error:
        profile_of(packets)
    for word in words:
        assert word in str(error.value)


def test_what_may_still_be_under_way_at_the_end_is_neither_lost_nor_delayed():
    way = ordered([0, 10, 20, 90], [30, 0, 50, 0], [False, True, False, True])
    # The record ends at 100; the longest delay is 50: of the packet sent at 90 nobody knows.
    kept, left_out = without_unfinished(way, 100)
    assert left_out == 1
    assert kept.sent_ns.tolist() == [0, 10, 20]
    assert kept.lost.tolist() == [False, True, False]


def test_a_time_without_packets_is_told_if_none_is_lost():
    packets = [(k * 10 * MS, MS) for k in range(40) if not 20 <= k < 30]
    words = "no packet is marked as lost, and 0.11 s passed without one, 0.01 s usually"
    assert any(words in note for note in profile_of(packets).metadata["notes"])
    told = profile_of([*packets, (400 * MS, LOST), (410 * MS, MS)]).metadata["notes"]
    assert not any("passed without" in note for note in told)


def test_high_quantiles_that_interpolation_lowers_are_told():
    packets = [(k * 10 * MS, (1 + 99 * (k % 10 == 5)) * MS) for k in range(100)]
    words = "99 % of the packets took at most 100 ms, 99 % of the periods"
    assert any(words in note for note in profile_of(packets).metadata["notes"])
    steady = [(k * 10 * MS, MS) for k in range(100)]
    assert not any("99 %" in note for note in profile_of(steady).metadata["notes"])
