"""What a cable may do to messages and what not, for any profile and any way of looking."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netem.delay_line import DelayLine
from netem.profile import DOWNLINK, LOST, UPLINK, DelayProfile
from shared.config.quantities import parse_outage
from shared.wire.operator.commands import AddDelay, ReplaceProfile
from shared.wire.operator.texts import parse_command

MS = 1_000_000
# In tenths of a millisecond: drawn in nanoseconds, most would be too short to overtake anything.
DELAY = st.integers(0, 500).map(lambda tenths: tenths * MS // 10)
DELAYS = st.lists(DELAY | st.just(LOST), min_size=1, max_size=20)
LOSSLESS = st.lists(DELAY, min_size=1, max_size=20)
# Gaps between sendings, from a burst to an outage of the sender [ns].
GAPS = st.lists(st.integers(0, 50).map(lambda tenths: tenths * MS // 10), min_size=1, max_size=40)

examples = settings(max_examples=150)


def profile_of(uplink, downlink=None):
    return DelayProfile("test", np.array([uplink, uplink if downlink is None else downlink]))


def make_line(uplink, direction=UPLINK, *, downlink=None, seed=0, **options):
    options = {"start_ns": 0, **options}
    rng = np.random.default_rng(seed)
    return DelayLine(profile_of(uplink, downlink), direction, rng=rng, **options)


def sending_times(gaps):
    return np.cumsum(gaps).tolist()


def release_all(line, times, looks):
    """Push number k at times[k] and look at the given times as well; (item, released at)."""
    released = []
    pushes = [(time, 0, k) for k, time in enumerate(times)]
    for time, is_look, k in sorted(pushes + [(time, 1, -1) for time in looks]):
        if is_look:
            released += [(due.item, time) for due in line.pop_due(time)]
        else:
            line.push(k, sent_ns=time)
    end = max(times) + 100 * MS
    return released + [(due.item, end) for due in line.pop_due(end)]


LOOKS = st.lists(st.integers(0, 3000).map(lambda tenths: tenths * MS // 10), max_size=30)


@examples
@given(delays=DELAYS, gaps=GAPS, looks=LOOKS, keep_order=st.booleans())
def test_never_early_never_twice_and_none_kept(delays, gaps, looks, keep_order):
    line, times = make_line(delays, keep_order=keep_order), sending_times(gaps)
    released = release_all(line, times, looks)
    for item, at in released:
        assert at >= times[item] + line.profile.delay_ns(UPLINK, times[item])
    counts = Counter(item for item, _ in released)
    assert all(count == 1 for count in counts.values())
    assert len(counts) + line.lost == len(times)
    assert len(line) == 0


@examples
@given(delays=LOSSLESS, gaps=GAPS, looks=LOOKS)
def test_everything_arrives_in_the_order_of_sending(delays, gaps, looks):
    line, times = make_line(delays, keep_order=True), sending_times(gaps)
    released = [item for item, _ in release_all(line, times, looks)]
    assert released == list(range(len(times)))


@examples
@given(delays=LOSSLESS, gaps=GAPS)
def test_a_message_is_due_at_its_sending_plus_the_delay_of_that_time(delays, gaps):
    line = make_line(delays, keep_order=False)
    for k, sent_ns in enumerate(sending_times(gaps)):
        expected = sent_ns + delays[sent_ns // MS % len(delays)]
        assert line.push(k, sent_ns=sent_ns) == expected


@examples
@given(delays=LOSSLESS, gaps=GAPS)
def test_keeping_order_waits_for_the_slowest_before_and_no_longer(delays, gaps):
    line, slowest = make_line(delays, keep_order=True), 0
    for k, sent_ns in enumerate(sending_times(gaps)):
        slowest = max(slowest, sent_ns + delays[sent_ns // MS % len(delays)])
        assert line.push(k, sent_ns=sent_ns) == slowest


@examples
@given(delays=LOSSLESS, gaps=GAPS, keep_order=st.booleans())
def test_a_released_message_tells_the_delay_it_was_given(delays, gaps, keep_order):
    line, due_at = make_line(delays, keep_order=keep_order), {}
    times = sending_times(gaps)
    for k, sent_ns in enumerate(times):
        due_at[k] = line.push(k, sent_ns=sent_ns)
    assert line.next_due_ns == min(due_at.values())
    released = line.pop_due(10**12)
    assert [due_at[due.item] for due in released] == sorted(due_at.values())
    for due in released:
        assert due.sent_ns == times[due.item]
        assert due.nominal_ns == due_at[due.item] - due.sent_ns
    assert line.next_due_ns is None


def test_a_later_message_overtakes_unless_order_is_kept():
    delays = [30 * MS, 1 * MS]
    for keep_order, expected in ((True, ["slow", "fast"]), (False, ["fast", "slow"])):
        line = make_line(delays, keep_order=keep_order)
        line.push("slow", sent_ns=0)
        line.push("fast", sent_ns=1 * MS)
        assert [due.item for due in line.pop_due(100 * MS)] == expected


def test_messages_due_at_the_same_time_leave_as_they_came():
    line = make_line([5 * MS], keep_order=False)
    for name in "cab":
        line.push(name, sent_ns=0)
    assert [due.item for due in line.pop_due(5 * MS)] == ["c", "a", "b"]


def test_a_message_leaves_at_its_due_time_and_not_a_nanosecond_before():
    line = make_line([5 * MS])
    line.push("x", sent_ns=0)
    assert line.pop_due(5 * MS - 1) == []
    assert [due.item for due in line.pop_due(5 * MS)] == ["x"]


def test_no_more_leave_than_are_asked_for_and_the_rest_stays_in_order():
    line = make_line([5 * MS])
    for k in range(5):
        line.push(k, sent_ns=0)
    released = [[due.item for due in line.pop_due(5 * MS, limit=2)] for _ in range(3)]
    assert released == [[0, 1], [2, 3], [4]]


def test_messages_without_an_order_of_their_own_can_be_held():
    line = make_line([5 * MS])
    for _ in range(2):
        line.push({"not": "comparable"}, sent_ns=0)
    assert len(line.pop_due(5 * MS)) == 2


def test_each_direction_has_its_own_delays():
    up = make_line([1 * MS], UPLINK, downlink=[2 * MS])
    down = make_line([1 * MS], DOWNLINK, downlink=[2 * MS])
    assert up.push("x", sent_ns=0) == 1 * MS
    assert down.push("x", sent_ns=0) == 2 * MS


def test_the_profile_repeats_when_it_ends():
    line = make_line([1 * MS, 2 * MS, 3 * MS], keep_order=False)
    delays = [line.push(k, sent_ns=k * MS) - k * MS for k in range(7)]
    assert delays == [MS, 2 * MS, 3 * MS, MS, 2 * MS, 3 * MS, MS]
    assert [line.passes(k * MS) for k in (0, 2, 3, 6)] == [0, 0, 1, 2]


def test_start_and_offset_say_where_in_the_profile_time_begins():
    line = make_line(
        [1 * MS, 2 * MS, 3 * MS], start_ns=100 * MS, offset_ns=2 * MS, keep_order=False
    )
    delays = [line.push(k, sent_ns=k * MS) - k * MS for k in (100, 101, 102)]
    assert delays == [3 * MS, 1 * MS, 2 * MS]
    assert [line.passes(k * MS) for k in (100, 101, 104)] == [0, 1, 2]


def test_a_message_from_before_the_start_takes_the_first_delay():
    line = make_line([1 * MS, 2 * MS], start_ns=100 * MS)
    assert line.push("x", sent_ns=97 * MS) == 98 * MS


def test_losses_of_the_profile_are_counted_and_nothing_else():
    line = make_line([LOST, 1 * MS, LOST, 1 * MS])
    due = [line.push(k, sent_ns=k * MS) for k in range(4)]
    assert [each is None for each in due] == [True, False, True, False]
    assert line.lost == 2
    assert len(line.pop_due(100 * MS)) == 2


def test_random_losses_come_at_their_rate_and_are_counted():
    line = make_line([0], loss=0.3)
    passed = sum(line.push(k, sent_ns=k) is not None for k in range(10_000))
    assert line.lost == 10_000 - passed
    # Four standard deviations of a binomial: √(10⁴ · 0.3 · 0.7) = 46.
    assert abs(line.lost - 3000) < 184


def test_the_same_seed_loses_the_same_messages():
    def lost(seed):
        line = make_line([0], loss=0.5, seed=seed)
        return [line.push(k, sent_ns=k) is None for k in range(100)]

    assert lost(1) == lost(1)
    assert lost(1) != lost(2)


@pytest.mark.parametrize("keep_order", [True, False])
def test_an_outage_ends_in_a_burst_in_order(keep_order):
    # A stall of 50 ms whose queue empties at once, as traces show it: delays that fall by the
    # sending period.
    delays = [MS * max(1, 50 - k) for k in range(60)]
    line = make_line(delays, keep_order=keep_order)
    for k in range(60):
        line.push(k, sent_ns=k * MS)
    assert line.pop_due(50 * MS - 1) == []
    assert [due.item for due in line.pop_due(50 * MS)] == list(range(50))


def outages(*texts):
    return [parse_outage(text) for text in texts]


def test_what_is_sent_in_an_outage_arrives_its_delay_after_the_end():
    line = make_line([2 * MS] * 50, outages=outages("10ms@20ms"))
    due = {sent: line.push(sent, sent_ns=sent * MS) for sent in (0, 19, 20, 29, 30)}
    assert {sent: at // MS for sent, at in due.items()} == {0: 2, 19: 21, 20: 32, 29: 32, 30: 32}


def test_an_outage_is_on_the_links_own_time_wherever_in_its_profile_it_begins():
    line = make_line([0] * 50, outages=outages("10ms@5ms"), start_ns=100 * MS, offset_ns=7 * MS)
    assert line.push("a", sent_ns=104 * MS) == 104 * MS
    assert line.push("b", sent_ns=105 * MS) == 115 * MS


def test_after_a_cut_nothing_arrives_but_what_was_under_way_does():
    line = make_line([5 * MS] * 50, outages=outages("cut@10ms"))
    assert line.push("before", sent_ns=9 * MS) == 14 * MS
    assert line.push("after", sent_ns=10 * MS) is None
    assert line.push("long after", sent_ns=10_000 * MS) is None
    assert line.lost == 2
    assert [due.item for due in line.pop_due(14 * MS)] == ["before"]


def commanded(line, *texts, now_ns, profile=None):
    for text in texts:
        line.change(parse_command(text), now_ns=now_ns, profile=profile, place_ns=0)


def due_ms(line, sent_ms):
    """Delays of messages sent at these times [ms]; None if lost."""
    due = [line.push(0, sent_ns=round(sent * MS)) for sent in sent_ms]
    return [None if at is None else at / MS - sent for at, sent in zip(due, sent_ms, strict=True)]


def test_a_cut_link_loses_everything_until_it_is_restored():
    line = make_line([10 * MS])
    assert due_ms(line, [0, 1]) == [10, 10]
    commanded(line, "link cut", now_ns=2 * MS)
    assert due_ms(line, [1.9, 2, 5000]) == [10, None, None]
    commanded(line, "link restore", now_ns=6000 * MS)
    assert due_ms(line, [6000]) == [10]


def test_an_outage_by_command_holds_messages_until_its_end():
    line = make_line([10 * MS], keep_order=False)
    commanded(line, "link outage 300ms", now_ns=100 * MS)
    assert due_ms(line, [99, 100, 250, 400]) == [10, 310, 160, 10]


@pytest.mark.parametrize(("direction", "added"), [(UPLINK, 41), (DOWNLINK, 40)])
def test_an_added_delay_is_half_of_it_each_way_until_it_is_restored(direction, added):
    line = make_line([10 * MS], direction)
    line.change(AddDelay(81 * MS), now_ns=0, profile=None, place_ns=0)
    assert due_ms(line, [0]) == [pytest.approx(10 + added, abs=0.51)]
    commanded(line, "link restore", now_ns=MS)
    assert due_ms(line, [1000]) == [10]


def test_loss_by_command_ends_with_the_one_of_the_settings():
    line = make_line([0], loss=0.5)
    commanded(line, "link loss 0%", now_ns=0)
    assert None not in due_ms(line, range(100))
    commanded(line, "link loss 90%", now_ns=0)
    assert 70 < due_ms(line, range(100, 200)).count(None) < 100
    commanded(line, "link restore", now_ns=200 * MS)
    assert 30 < due_ms(line, range(200, 300)).count(None) < 70


def test_another_profile_begins_at_its_place_when_it_is_given():
    line = make_line([10 * MS], start_ns=50 * MS, keep_order=False)
    other = DelayProfile("other", np.array([[1 * MS, 2 * MS, 3 * MS]] * 2))
    assert due_ms(line, [59]) == [10]
    line.change(ReplaceProfile("other"), now_ns=60 * MS, profile=other, place_ns=1 * MS)
    assert due_ms(line, [60, 61, 62, 63]) == [2, 3, 1, 2]


def test_the_memory_of_outages_is_bounded():
    line = make_line([MS])
    for k in range(1000):
        commanded(line, "link outage 10s", "link cut", now_ns=k * MS)
    assert len(line._outages) <= 101
    commanded(line, "link restore", now_ns=1000 * MS)
    assert line._outages == ()
