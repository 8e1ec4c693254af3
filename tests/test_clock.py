from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.clock import ScaledClock, SimClock, Ticker, sleep_until

MS = 1_000_000


@pytest.fixture
def ticker():
    return Ticker(start_ns=1000 * MS, period_ns=MS, max_backlog_ns=50 * MS)


def test_a_simulated_clock_stands_still_until_it_is_moved():
    clock = SimClock()
    assert clock.now_ns() == clock.now_ns() == 0
    clock.time_ns = 5
    assert clock.now_ns() == 5


def test_sleeping_never_ends_early():
    for delay_ns in (200_000, 2 * MS):
        due_ns = time.monotonic_ns() + delay_ns
        sleep_until(due_ns)
        assert time.monotonic_ns() >= due_ns


def test_a_time_that_has_passed_is_not_slept_for():
    started = time.monotonic_ns()
    sleep_until(started - 10**12)
    # A second, on any machine: the mistake would be to sleep for ever or for the difference.
    assert time.monotonic_ns() - started < 10**9


def test_ticks_are_due_on_an_absolute_schedule(ticker):
    # The tick ends anywhere within its period: the next one does not move with it.
    for k in range(1, 6):
        assert ticker.next((999 + k) * MS + 137_000 * k) == (1000 + k) * MS
    assert (ticker.overruns, ticker.ticks_given_up) == (0, 0)


def test_a_tick_that_ends_when_the_next_one_is_due_is_in_time(ticker):
    ticker.next(1001 * MS)
    assert ticker.overruns == 0
    ticker.next(1002 * MS + 1)
    assert ticker.overruns == 1


def test_after_an_overrun_ticks_catch_up_back_to_back(ticker):
    # 3.5 ms in one tick: three schedule times have passed and stay in the schedule.
    dues = [ticker.next(1000 * MS + 3_500_000)]
    assert dues == [1001 * MS]
    for _ in range(4):
        dues.append(ticker.next(1003 * MS + 600_000))
    assert dues == [(1001 + k) * MS for k in range(5)]
    assert ticker.overruns == 3
    assert ticker.ticks_given_up == 0


def test_a_stall_beyond_the_backlog_moves_the_schedule_and_counts_what_is_given_up(ticker):
    stalled_ns = 1000 * MS + 200 * MS + 300_000
    due_ns = ticker.next(stalled_ns)
    # The next due time is the last one of the schedule before now, not 199 ticks ago.
    assert due_ns == 1200 * MS
    assert due_ns % MS == 0
    assert ticker.overruns == 1
    assert ticker.ticks_given_up == 199


def test_a_stall_within_the_backlog_gives_nothing_up(ticker):
    ticker.next(1000 * MS + 51 * MS)
    assert ticker.ticks_given_up == 0
    ticker.next(1000 * MS + 52 * MS + 1)
    assert ticker.ticks_given_up == 50


@given(gaps=st.lists(st.integers(0, 200 * MS), min_size=1, max_size=50))
def test_no_tick_of_the_schedule_goes_missing_uncounted(gaps):
    ticker, now_ns = Ticker(start_ns=0, period_ns=MS), 0
    for k, gap in enumerate(gaps, start=1):
        now_ns += gap
        due_ns = ticker.next(now_ns)
        assert due_ns == (k + ticker.ticks_given_up) * MS
        assert now_ns - due_ns <= ticker.max_backlog_ns
        now_ns = max(now_ns, due_ns)


def test_a_scaled_clock_is_the_monotonic_one_until_its_speed_is_set():
    clock = ScaledClock()
    assert clock.at(123_456_789_012_345_678) == 123_456_789_012_345_678
    before, now_ns, after = time.monotonic_ns(), clock.now_ns(), time.monotonic_ns()
    assert before <= now_ns <= after


def test_a_scaled_clock_goes_on_slower_from_where_it_was():
    clock = ScaledClock()
    clock.origin = (1000, 500, 0.25)
    assert clock.at(1000) == 500
    assert clock.at(1400) == 600
    clock.run_at(0.0)
    stood_ns = clock.now_ns()
    assert clock.now_ns() == stood_ns
    clock.run_at(1.0)
    monotonic_ns, own_ns, _ = clock.origin
    assert own_ns == stood_ns
    assert clock.at(monotonic_ns + 7) == stood_ns + 7


@pytest.mark.parametrize("speed", [0.25, 1.0])
def test_sleeping_on_a_scaled_clock_never_ends_early(speed):
    clock = ScaledClock()
    clock.run_at(speed)
    due_ns = clock.now_ns() + MS
    clock.sleep_until(due_ns)
    assert clock.now_ns() >= due_ns


def test_a_clock_that_stands_still_is_not_slept_for():
    clock = ScaledClock()
    clock.run_at(0.0)
    clock.sleep_until(clock.now_ns() + 10**18)
