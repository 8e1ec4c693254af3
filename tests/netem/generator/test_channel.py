from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.generator.blockage import WAVELENGTH, Blockers, covers, knife_edge_loss_db
from netem.generator.channel import BUILDING, FACTORY, SCENARIOS, draw_channel, path_loss_db
from netem.generator.rate_adaptation import SPECTRAL_EFFICIENCY, capacity_per_ms, payload_per_ms

distances = st.floats(1.0, 200.0)
offsets = st.floats(-5.0, 5.0)
widths = st.floats(0.02, 1.0)


def loss(offset, width, *, before=10.0, behind=15.0):
    return float(knife_edge_loss_db(np.array(offset), width, before=before, behind=behind))


# By hand from TR 38.901 Table 7.4.1-1 with log₁₀ 28 = 1.44716.
@pytest.mark.parametrize(
    ("indoor", "line_of_sight", "distance", "expected"),
    [
        (False, True, 100.0, 32.4 + 42.0 + 28.943),
        (False, True, 10.0, 32.4 + 21.0 + 28.943),
        (False, False, 100.0, 22.4 + 70.6 + 30.824),
        (True, True, 10.0, 32.4 + 17.3 + 28.943),
        (True, False, 10.0, 17.3 + 38.3 + 36.034),
        # So near the second term is the smaller one.
        (True, False, 1.0, 32.4 + 28.943),
    ],
)
def test_path_loss_is_that_of_the_standard(indoor, line_of_sight, distance, expected):
    found = path_loss_db(np.array([distance]), indoor=indoor, line_of_sight=line_of_sight)
    assert found[0] == pytest.approx(expected, abs=1e-3)


def test_a_metre_of_the_robots_height_is_worth_three_tenths_of_a_decibel_in_the_street():
    low, high = (
        path_loss_db(np.array([50.0]), indoor=False, line_of_sight=False, robot_height=height)[0]
        for height in (1.5, 2.5)
    )
    assert low - high == pytest.approx(0.3)


@given(distance=distances, indoor=st.booleans())
def test_a_line_of_sight_never_loses_more(distance, indoor):
    with_line, without = (
        path_loss_db(np.array([distance]), indoor=indoor, line_of_sight=line)[0]
        for line in (True, False)
    )
    assert without >= with_line


def test_a_screen_far_from_the_line_loses_nothing():
    # The edges' terms cancel like width / offset²; at 100 m that is nothing.
    assert loss(100.0, 0.4) == pytest.approx(0.0, abs=1e-3)


def test_a_single_edge_that_grazes_the_line_loses_six_decibels():
    # Half of the plane is covered, so half of the amplitude is gone; the other edge is 1 km away.
    assert loss(500.0, 1000.0) == pytest.approx(20.0 * math.log10(2.0), abs=0.02)


def test_a_screen_in_the_middle_of_the_line_loses_what_the_formula_gives_by_hand():
    half, leg = 0.15, 10.0
    excess = 2.0 * (math.sqrt(leg**2 + half**2) - leg)
    edge = math.atan(math.pi / 2 * math.sqrt(math.pi / WAVELENGTH * excess)) / math.pi
    expected = -20.0 * math.log10(1.0 - 2.0 * edge)
    assert loss(0.0, 2 * half, before=leg, behind=leg) == pytest.approx(expected, rel=1e-9)


@given(offset=offsets, width=widths, before=distances, behind=distances)
def test_the_loss_is_never_a_gain_and_does_not_care_for_side_or_direction(
    offset, width, before, behind
):
    found = loss(offset, width, before=before, behind=behind)
    assert found >= -1e-9
    assert loss(-offset, width, before=before, behind=behind) == pytest.approx(found, abs=1e-9)
    assert loss(offset, width, before=behind, behind=before) == pytest.approx(found, abs=1e-9)


@given(width=widths)
def test_the_loss_grows_as_the_screen_comes_nearer(width):
    approach = knife_edge_loss_db(np.linspace(3.0, 0.0, 200), width, before=10.0, behind=15.0)
    assert np.all(np.diff(approach) >= -1e-9)


def test_a_blocker_goes_to_and_fro_at_its_speed_and_cuts_the_line_for_its_width_each_time():
    blockers = Blockers(
        fraction=np.array([0.5]),
        width=np.array([0.4]),
        depth=np.array([0.3]),
        start=np.array([1.0]),
        half_track=2.0,
        speed=2.0,
    )
    seconds = np.arange(0.0, 8.0, 1e-3)
    track = blockers.positions(seconds)
    assert np.abs(track).max() == pytest.approx(2.0, abs=2e-3)
    assert np.abs(np.diff(track)).max() == pytest.approx(2e-3)
    cut = covers(track, blockers.screens(np.zeros(len(seconds))))[0]
    # 16 m at 2 m/s over a track of 4 m cross the middle 4 times, for 0.4 m each.
    assert np.sum(np.diff(cut.astype(int)) == 1) == 4
    assert cut.sum() == pytest.approx(4 * 200, abs=8)


def test_seen_aslant_a_blocker_is_wider_by_its_depth():
    blockers = Blockers(np.array([0.5]), np.array([0.4]), np.array([0.3]), np.zeros(1), 2.0, 2.0)
    assert blockers.screens(np.array([0.0, 0.5, -0.5])).tolist() == [[0.4, 0.55, 0.55]]


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=str)
def test_the_robot_stays_where_the_scenario_puts_it(scenario):
    nearest, furthest = scenario.distance
    for seed in range(20):
        channel = draw_channel(scenario, np.random.default_rng(seed), 13_000)
        # It walks 3 m from where it was put; the access point hangs higher than it.
        above = scenario.heights[0] - scenario.heights[1]
        assert channel.distance.min() >= np.hypot(nearest - 3.0, above) - 1e-9
        assert channel.distance.max() <= np.hypot(furthest + 3.0, above) + 1e-9


@pytest.mark.parametrize("scenario", [FACTORY, BUILDING], ids=["factory", "building"])
def test_a_cut_line_costs_more_than_ten_decibels(scenario):
    channels = [draw_channel(scenario, np.random.default_rng(seed), 6000) for seed in range(30)]
    snr_db = np.concatenate([channel.snr_db for channel in channels])
    cut = np.concatenate([channel.n_block > 0 for channel in channels])
    # Table 7.4.1-1 alone gives 13 dB at 50 m and 13 dB at 10 m.
    assert np.median(snr_db[~cut]) - np.median(snr_db[cut]) > 10.0


def test_in_the_building_a_fade_is_never_deeper_than_its_limit():
    alone = replace(BUILDING, shadow_db=(0.0, 0.0), width=(1e-9, 1e-9))
    gains = []
    for seed in range(60):
        channel = draw_channel(alone, np.random.default_rng(seed), 6000)
        loss = path_loss_db(channel.distance, indoor=True, line_of_sight=True)
        gains.append((channel.snr_db + loss - 5.0 - 79.0)[channel.n_block == 0])
    deepest = np.concatenate(gains).min() - BUILDING.gain_db[0]
    # 60 × 60 draws of a K-factor that is often below 3 dB: some reach the limit.
    assert deepest == pytest.approx(-15.0, abs=1e-3)


def test_the_rate_climbs_with_the_snr_up_to_the_last_row_of_the_table():
    payload = payload_per_ms(np.linspace(-30.0, 60.0, 500))
    assert np.all(np.diff(payload) >= 0.0)
    assert payload[0] == 0.0
    assert payload[-1] / payload_per_ms(np.array([1.0]))[0] == pytest.approx(
        SPECTRAL_EFFICIENCY[-1] / SPECTRAL_EFFICIENCY[0]
    )


def test_the_spectral_efficiency_is_one_that_the_gap_to_shannon_allows():
    # log₂(1 + 10 / 5.53) = 1.49 bit/s/Hz at 10 dB: the highest row below is 1.4766.
    at_ten_db, top = payload_per_ms(np.array([10.0, 60.0]))
    assert at_ten_db / top == pytest.approx(1.4766 / 5.5547)


def test_a_link_that_is_always_good_carries_all_that_its_rate_allows():
    snr_db = np.full(50, 20.0)
    uplink, downlink = capacity_per_ms(snr_db, np.random.default_rng(0))
    assert np.all(downlink == payload_per_ms(snr_db))
    assert np.all(uplink == 0.5 * downlink)


@given(lasting=st.integers(1, 300), depth=st.floats(-40.0, -8.0), seed=st.integers(0, 2**32))
def test_an_outage_outlasts_its_cause_by_no_more_than_a_probe_and_the_release(lasting, depth, seed):
    snr_db = np.full(600, 20.0)
    snr_db[100 : 100 + lasting] = depth
    uplink, downlink = capacity_per_ms(snr_db, np.random.default_rng(seed))
    for way, more in ((uplink, 0.0), (downlink, 4.0 + 0.04 * (lasting + 13))):
        silent = np.flatnonzero(way == 0.0)
        assert silent[0] == 100
        assert np.all(np.diff(silent) == 1)
        assert silent[-1] >= 100 + lasting - 1
        # 13 ms to the next probe, 2.5 + 3 ms of release
        assert silent[-1] <= 100 + lasting + 13 + 5.5 + more


def test_a_link_of_probes_carries_something_and_a_worse_one_nothing():
    rng = np.random.default_rng(0)
    fallen, dead = (
        np.concatenate([np.full(50, 20.0), np.full(500, snr_db)]) for snr_db in (-3.0, -12.0)
    )
    assert 0.0 < capacity_per_ms(fallen, rng)[0, 50:].mean() < 1000.0
    assert capacity_per_ms(dead, rng)[:, 50:].max() == 0.0
