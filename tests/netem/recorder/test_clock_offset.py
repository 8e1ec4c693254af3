"""The far clock's lead from time stamps of messages, for any delays, leads and drifts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from netem.recorder.clock_offset import (
    MAX_DRIFT,
    NEVER,
    Stamps,
    equal_least_delays,
    one_clock,
    synchronised,
)

MS = 1_000_000
US = 1_000
LEADS = st.integers(-(10**18), 10**18)
DRIFTS_PPM = st.floats(-400.0, 400.0)
# From a wired path to an outage [ns]; drawn in µs, as nanoseconds would shrink to nothing else.
EXTRA = st.integers(0, 300_000).map(lambda us: us * US)
EXTRAS = st.lists(EXTRA, min_size=4, max_size=40)

examples = settings(max_examples=200)


class FarClock:
    """Shows `lead_ns` more than the near clock at its time 0, and runs `drift_ppm` faster."""

    def __init__(self, lead_ns, drift_ppm):
        self.lead_ns, self.drift_ppm = lead_ns, drift_ppm

    def shows(self, near_ns):
        near_ns = np.asarray(near_ns, dtype=np.int64)
        drift_ns = np.rint(1e-6 * self.drift_ppm * near_ns).astype(np.int64)
        return near_ns + self.lead_ns + drift_ns


def stamps_of(far, up_delays, down_delays, *, period_ns=100 * MS):
    """Messages sent each way once per period, with these delays (n,) [ns]."""
    up_sent = np.arange(len(up_delays)) * period_ns
    down_sent = np.arange(len(down_delays)) * period_ns + period_ns // 3
    return (
        Stamps(up_sent, far.shows(up_sent + np.array(up_delays))),
        Stamps(far.shows(down_sent), down_sent + np.array(down_delays)),
    )


def errors_ns(clock, far, near_ns):
    """Estimated minus true near time when the near clock shows `near_ns`."""
    return clock.to_near(far.shows(near_ns)) - near_ns


@examples
@given(LEADS, DRIFTS_PPM, st.integers(0, 50 * MS), EXTRAS, EXTRAS)
def test_lead_and_drift_are_exact_where_both_ways_reach_the_same_least_delay(
    lead, drift, least, up_extra, down_extra
):
    far = FarClock(lead, drift)
    n = min(len(up_extra), len(down_extra))
    # The first and the last messages find the link empty.
    up, down = (
        [least, *(least + extra for extra in extras[: n - 2]), least]
        for extras in (up_extra, down_extra)
    )
    clock = equal_least_delays(*stamps_of(far, up, down))
    # Stamps are whole nanoseconds, and so are drifts over them.
    near_ns = np.linspace(0, n * 100 * MS, 20).astype(np.int64)
    assert np.abs(errors_ns(clock, far, near_ns)).max() <= 3
    assert clock.uncertainty_ns == pytest.approx(least, abs=3)
    # Per second of the far clock, where ours says how it runs per second of the near one.
    drift_of_far = drift / (1.0 + 1e-6 * drift)
    assert clock.drift_ppm == pytest.approx(drift_of_far, abs=1e6 * 5 / (n * 100 * MS))


@examples
@given(LEADS, DRIFTS_PPM, EXTRAS, EXTRAS)
def test_no_message_arrives_before_it_was_sent_and_least_delays_are_equal(lead, drift, up, down):
    sent_up, sent_down = stamps_of(FarClock(lead, drift), up, down)
    clock = equal_least_delays(sent_up, sent_down)
    up_ns = clock.to_near(sent_up.received_ns) - sent_up.sent_ns
    down_ns = sent_down.received_ns - clock.to_near(sent_down.sent_ns)
    # −2: a message without any delay, and stamps in whole nanoseconds.
    assert min(up_ns.min(), down_ns.min()) >= -2
    assert abs(up_ns.min() - down_ns.min()) <= 2
    assert clock.uncertainty_ns == pytest.approx(up_ns.min(), abs=2)


@examples
@given(LEADS, DRIFTS_PPM, EXTRAS, EXTRAS)
def test_the_truth_lies_within_the_uncertainty_whatever_the_asymmetry(lead, drift, up, down):
    far = FarClock(lead, drift)
    clock = equal_least_delays(*stamps_of(far, up, down))
    assume(abs(clock.drift_ppm) < MAX_DRIFT * 1e6)
    # At the instant of the least round trip, whenever it was; beside it a wrong drift adds.
    first, last = errors_ns(clock, far, np.array([0, (max(len(up), len(down)) + 4) * 100 * MS]))
    smallest = 0 if first * last < 0 else min(abs(first), abs(last))
    assert clock.uncertainty_ns is not None
    assert smallest <= clock.uncertainty_ns + 2


@examples
@given(LEADS, EXTRAS, EXTRAS, st.randoms())
def test_the_order_of_messages_does_not_matter(lead, up, down, random):
    far = FarClock(lead, 50.0)
    first, second = stamps_of(far, up, down)
    order = list(range(1, len(up)))
    random.shuffle(order)
    order = [0, *order]
    shuffled = Stamps(first.sent_ns[order], first.received_ns[order])
    assert equal_least_delays(shuffled, second) == equal_least_delays(first, second)


def test_an_asymmetric_path_shifts_the_lead_by_half_the_difference_and_no_more():
    far = FarClock(5 * MS, 0.0)
    clock = equal_least_delays(*stamps_of(far, [2 * MS] * 50, [10 * MS] * 50))
    assert clock.offset_ns == 5 * MS - 4 * MS
    assert clock.uncertainty_ns == 6 * MS


def test_a_minute_of_noise_and_outages_leaves_the_drift_within_a_tenth_of_a_ppm():
    rng = np.random.default_rng(3)
    n = 60_000
    delays = 2 * MS + rng.exponential(0.2 * MS, (2, n))
    delays[:, 10_000:10_400] += 300 * MS
    delays[1, 59_000:] += 80 * MS
    far = FarClock(-(10**15), 87.0)
    clock = equal_least_delays(*stamps_of(far, *delays.astype(int), period_ns=MS))
    assert clock.drift_ppm == pytest.approx(87.0, abs=0.1)
    near_ns = np.linspace(0, n * MS, 50).astype(np.int64)
    assert np.abs(errors_ns(clock, far, near_ns)).max() < 5 * US


def test_lost_messages_are_left_out():
    far = FarClock(7 * MS, 0.0)
    up, down = stamps_of(far, [3 * MS] * 6, [3 * MS] * 6)
    up.received_ns[[0, 3]] = NEVER
    down.sent_ns[2] = down.received_ns[2] = NEVER
    assert equal_least_delays(up, down).offset_ns == 7 * MS


def test_on_one_machine_nothing_is_estimated():
    clock = one_clock(123)
    assert (clock.offset_ns, clock.uncertainty_ns, clock.drift_ppm) == (0, 0, 0.0)
    assert clock.to_near(np.array([5 * MS]))[0] == 5 * MS


@given(st.integers(-20 * MS, 20 * MS))
def test_synchronised_clocks_are_believed_until_a_message_arrives_before_it_was_sent(lead):
    stamps = stamps_of(FarClock(lead, 0.0), [4 * MS] * 5, [6 * MS] * 5)
    clock = synchronised(*stamps)
    assert (clock is None) == (lead < -4 * MS or lead > 6 * MS)
    if clock is not None:
        assert clock.offset_ns == 0
        assert clock.uncertainty_ns is None
