"""From the stamps of both ends to a delay for every period."""

from __future__ import annotations

import numpy as np
import pytest

from netem.profile import LOST
from netem.recorder.clock_offset import NEVER, Stamps, one_clock
from netem.recorder.probe import ProbeSettings
from netem.recorder.recording import estimate_clock, fill_sending_times, reconstruct, resample
from shared.errors import LinkError

MS = 1_000_000
SETTINGS = ProbeSettings(period_ns=MS, uplink_bytes=200, downlink_bytes=400)


def test_sending_times_of_lost_messages_are_drawn_in_between():
    known = Stamps(np.array([NEVER, 11, NEVER, NEVER, 17, NEVER]), np.zeros(6, dtype=np.int64))
    assert fill_sending_times(known, period_ns=2).tolist() == [9, 11, 13, 15, 17, 19]


def test_a_period_takes_the_message_nearest_to_its_middle():
    sent = np.array([4, 16, 24, 29, 46])
    delays, held = resample(sent, np.arange(5), start_ns=0, period_ns=10, n=5)
    assert delays.tolist() == [0, 1, 2, 3, 4]
    assert held == 0


def test_periods_slept_through_hold_the_nearest_delay_and_are_counted():
    sent = np.array([5, 15, 75, 85]) * MS
    delays, held = resample(sent, np.array([1, 2, 3, LOST]), start_ns=0, period_ns=10 * MS, n=10)
    assert delays.tolist() == [1, 2, 2, 2, 2, 3, 3, 3, LOST, LOST]
    # Those whose middle is more than a period from any message.
    assert held == 3


def test_a_single_message_is_a_profile():
    delays, _ = resample(np.array([5]), np.array([7]), start_ns=0, period_ns=10, n=2)
    assert delays.tolist() == [7, 7]


def test_a_way_that_lost_everything_is_no_profile():
    up = Stamps(np.arange(10) * MS, np.arange(10) * MS + 5)
    down = Stamps(np.arange(10) * MS, np.full(10, NEVER))
    with pytest.raises(LinkError, match="expected downlink messages, got none"):
        estimate_clock(up, down, same_clock=True, same_time=False)
    down.received_ns[0] = 8
    with pytest.raises(LinkError, match="downlink messages that arrive, got only lost"):
        reconstruct(
            up, down, one_clock(0), settings=SETTINGS, name="x", start_ns=5 * MS, end_ns=9 * MS,
            metadata={},
        )  # fmt: skip
