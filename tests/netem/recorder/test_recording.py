"""A whole recording between two ends over a simulated cable."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netem.delay_line import DelayLine
from netem.networks import load_profile
from netem.profile import DOWNLINK, LOST, UPLINK, DelayProfile
from netem.profile_file import read_profile, write_profile
from netem.recorder.clock_offset import NEVER
from netem.recorder.probe import Instant, ProbeSettings
from netem.recorder.probe_far import FarEnd
from netem.recorder.probe_near import NearEnd
from netem.recorder.recording import estimate_clock, reconstruct
from shared.config.quantities import parse_outage

MS = 1_000_000
SETTINGS = ProbeSettings(period_ns=MS, uplink_bytes=200, downlink_bytes=400)
# The near clock at the start of a simulation: days of uptime.
EPOCH = 3 * 10**14


class Simulation:
    """A recording in simulated time. Its true clock is the near one; `start` is when it began."""

    def __init__(self, profile, *, lead_ns=0, drift_ppm=0.0, one_clock=True, late_ns=(0,), **cable):
        self.near = NearEnd(SETTINGS, session=7, capacity=5000)
        self.far = FarEnd()
        self.start_ns = EPOCH
        self._lead_ns, self._drift_ppm, self._one_clock = lead_ns, drift_ppm, one_clock
        self._late_ns = late_ns
        rng = np.random.default_rng(5)
        options: dict[str, Any] = {"keep_order": False, **cable}
        self._lines: list[DelayLine[bytes]] = [
            DelayLine(profile, way, start_ns=EPOCH, rng=rng, **options)
            for way in (UPLINK, DOWNLINK)
        ]
        # When, in which order, what (an end that is due, or a message on its way), which number.
        self._events: list[tuple[int, int, str | int, int]] = [(EPOCH, 0, "near", 0)]
        self._pushed = 1

    def run(self, *, periods):
        """Connect, measure so long, drain; returns what is measured, start and end."""
        measured, far_next = 0, None
        start_ns = end_ns = 0
        quiet_ns = 0
        while self._events:
            now_ns, _, what, number = heapq.heappop(self._events)
            if what == "near":
                now = self._late(now_ns, number)
                if self.near.answered and not measured:
                    start_ns = now_ns - MS // 2
                measured += self.near.answered
                end_ns = start_ns + periods * MS
                self.near.draining |= measured > periods
                self._send(UPLINK, self.near.message(Instant(now, now)), now)
                quiet_ns = now - max(end_ns, self.near.last_news_ns)
                done = self.near.draining and (self.near.complete or quiet_ns > 1500 * MS)
                if not done:
                    self._at(now_ns + (10 * MS if self.near.draining else MS), "near", number + 1)
            elif what == "far" and self.far.recording is not None:
                now = self._late(now_ns, number)
                instant = self._far_instant(now)
                if self.far.recording.over(instant):
                    break
                self._send(DOWNLINK, self.far.recording.message(instant), now)
                self._at(now_ns + MS, "far", number + 1)
            elif what == UPLINK:
                for due in self._lines[UPLINK].pop_due(now_ns):
                    self.far.take(due.item, self._far_instant(now_ns))
                if far_next is None:
                    far_next = now_ns
                    self._at(now_ns + MS // 3, "far", 0)
            elif what == DOWNLINK:
                for due in self._lines[DOWNLINK].pop_due(now_ns):
                    self.near.take(due.item, Instant(now_ns, now_ns), one_clock=self._one_clock)
        return start_ns, end_ns

    def record(self, *, periods):
        """What the near end makes of it."""
        start_ns, end_ns = self.run(periods=periods)
        up, down = self.near.stamps()
        clock, _ = estimate_clock(up, down, same_clock=self.near.one_clock, same_time=False)
        return reconstruct(
            up, down, clock, settings=SETTINGS, name="x", start_ns=start_ns, end_ns=end_ns,
            metadata={},
        )  # fmt: skip

    def _late(self, due_ns, number):
        return due_ns + self._late_ns[number % len(self._late_ns)]

    def _far_instant(self, near_ns):
        elapsed_ns = near_ns - EPOCH
        shows = near_ns + self._lead_ns + round(1e-6 * self._drift_ppm * elapsed_ns)
        return Instant(shows, shows)

    def _send(self, way, data, now_ns):
        due_ns = self._lines[way].push(data, sent_ns=now_ns)
        if due_ns is not None:
            self._at(due_ns, way, 0)

    def _at(self, time_ns, what, number):
        heapq.heappush(self._events, (time_ns, self._pushed, what, number))
        self._pushed += 1


def expected_ns(profile, recorded, way, *, spread=1):
    """Per recorded period the profile's delays around it, (periods, 2 spread + 1) [ns]."""
    start_ns = recorded.profile.metadata["start_ns"] - EPOCH
    n = recorded.profile.delays_ns.shape[1]
    middles = (start_ns + MS // 2 + np.arange(n) * MS) // MS
    around = middles[:, None] + np.arange(-spread, spread + 1)[None, :]
    return profile.delays_ns[way][around % profile.delays_ns.shape[1]]


DELAY = st.integers(0, 400).map(lambda tenths: tenths * MS // 10)
# One delay at least that is none, so that a recording can begin.
WAY = st.lists(DELAY | st.just(LOST), min_size=6, max_size=6)
PROFILES = st.tuples(WAY, WAY).map(
    lambda ways: DelayProfile("x", np.repeat([[MS, *way] for way in ways], 20, axis=1))
)
# Up to a third of a period, past which neighbours' messages are as near.
LATE = st.lists(st.integers(0, MS // 3), min_size=1, max_size=7)

examples = settings(max_examples=25, deadline=None)


@examples
@given(PROFILES, LATE)
def test_recording_a_profile_gives_it_back_with_its_losses_and_reordering(profile, late):
    simulation = Simulation(profile, late_ns=late)
    recorded = simulation.record(periods=140)
    for way in (UPLINK, DOWNLINK):
        got = recorded.profile.delays_ns[way]
        assert np.all(np.any(got[:, None] == expected_ns(profile, recorded, way), axis=1))
    assert recorded.held == (0, 0)
    assert simulation.near.refused == {}
    assert simulation.far.refused == {}


@examples
@given(PROFILES, st.integers(-(10**13), 10**13), st.floats(-150.0, 150.0))
def test_without_a_common_clock_only_the_least_delays_asymmetry_is_missing(profile, lead, drift):
    # The same least delay both ways, found all along: then nothing is missing.
    delays = profile.delays_ns
    delays[delays != LOST] = np.maximum(delays[delays != LOST], MS)
    delays[:, ::10] = MS
    recorded = Simulation(profile, lead_ns=lead, drift_ppm=drift, one_clock=False).record(
        periods=200
    )
    assert recorded.clock.uncertainty_ns == pytest.approx(MS, abs=5)
    for way in (UPLINK, DOWNLINK):
        got = recorded.profile.delays_ns[way]
        wrong = np.abs(got[:, None] - expected_ns(profile, recorded, way))
        assert np.all(wrong.min(axis=1) <= 10)


def test_asymmetry_is_shared_between_the_ways():
    profile = load_profile("constant:4ms/10ms")
    recorded = Simulation(profile, lead_ns=10**12, one_clock=False).record(periods=50)
    assert np.all(recorded.profile.delays_ns == 7 * MS)
    assert recorded.clock.offset_ns == 10**12 - 3 * MS
    assert recorded.clock.uncertainty_ns == 7 * MS


@pytest.mark.parametrize("keep_order", [False, True])
def test_an_outage_is_recorded_as_it_was(keep_order):
    profile = load_profile("constant:6ms")
    recorded = Simulation(
        profile, outages=[parse_outage("200ms@50ms")], keep_order=keep_order
    ).record(periods=400)
    start_ns = recorded.profile.metadata["start_ns"] - EPOCH
    middles = start_ns + MS // 2 + np.arange(400) * MS
    stalled = (middles >= 50 * MS) & (middles < 250 * MS)
    expected = 3 * MS + np.where(stalled, 250 * MS - middles, 0)
    # A period's message was sent within half a period of its middle.
    assert np.abs(recorded.profile.delays_ns - expected).max() <= MS // 2


def test_a_cut_link_is_lost_until_the_end_and_what_was_measured_is_kept():
    simulation = Simulation(load_profile("constant:6ms"), outages=[parse_outage("cut@100ms")])
    recorded = simulation.record(periods=300)
    assert not simulation.near.drained
    before = (100 * MS - (recorded.profile.metadata["start_ns"] - EPOCH)) // MS
    for delays in recorded.profile.delays_ns:
        # What was reported 3 ms later at the latest came through.
        assert np.all(delays[: before - 4] == 3 * MS)
        assert np.all(delays[before + 1 :] == LOST)


def test_random_losses_lose_no_stamp_of_a_message_that_arrived():
    simulation = Simulation(load_profile("constant:20ms"), loss=0.3)
    recorded = simulation.record(periods=1000)
    for delays in recorded.profile.delays_ns:
        assert set(np.unique(delays)) == {LOST, 10 * MS}
        # Three standard deviations of 1000 draws.
        assert np.mean(delays == LOST) == pytest.approx(0.3, abs=0.045)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_the_file_is_a_profile_that_says_where_it_comes_from(tmp_path, suffix):
    profile = load_profile("constant:4ms/10ms")
    recorded = Simulation(profile, lead_ns=10**12, one_clock=False).record(periods=50)
    path = tmp_path / f"mylink{suffix}"
    write_profile(recorded.profile, path)
    read = read_profile(path)
    assert np.array_equal(read.delays_ns, recorded.profile.delays_ns)
    assert read.period_ns == MS
    assert read.metadata["offset_ns"] == 10**12 - 3 * MS
    assert read.metadata["uncertainty_ns"] == 7 * MS
    assert read.metadata["drift_ppm"] == 0.0
    assert read.metadata["clock"] == "equal least delays both ways"


def test_clocks_said_to_be_synchronised_that_are_not_are_estimated_with_a_warning():
    simulation = Simulation(load_profile("constant:8ms"), lead_ns=50 * MS, one_clock=False)
    simulation.run(periods=30)
    clock, warning = estimate_clock(*simulation.near.stamps(), same_clock=False, same_time=True)
    assert clock.offset_ns == 50 * MS
    assert "46.000 ms apart or more" in warning


def test_who_watches_sees_delays_near_the_true_ones_though_clocks_drift():
    simulation = Simulation(
        load_profile("constant:8ms"), lead_ns=-(10**14), drift_ppm=-150.0, one_clock=False
    )
    simulation.run(periods=2500)
    progress = simulation.near.progress
    # 2.5 s of drift are 0.4 ms; what is forgotten in the round trip is a few µs.
    assert progress.uplink_ns == pytest.approx(4 * MS, abs=0.02 * MS)
    assert progress.downlink_ns == pytest.approx(4 * MS, abs=0.02 * MS)
    assert (progress.uplink_lost, progress.downlink_lost) == (0, 0)


def test_without_losses_the_near_end_knows_that_nothing_is_missing():
    simulation = Simulation(load_profile("constant:8ms"))
    simulation.run(periods=40)
    assert simulation.near.complete
    assert all(np.all(way.received_ns != NEVER) for way in simulation.near.stamps())
