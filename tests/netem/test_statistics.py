from __future__ import annotations

import math

import numpy as np
import pytest

from netem.networks import load_profile
from netem.profile import LOST, DelayProfile
from netem.statistics import autocorrelation, delay_spikes, delays_ms, statistics

MS = 1_000_000


def profile(up_ms, down_ms):
    delays = np.array([up_ms, down_ms], dtype=float)
    return DelayProfile("p", np.where(delays < 0, LOST, np.rint(delays * MS)).astype(np.int64))


def test_a_round_trip_is_up_and_then_down_from_when_it_arrives():
    # Up takes 2 ms: the answer to the first leaves in period 2, that to the last in the next pass.
    p = profile([2.0, 2.0, 2.5, 0.0], [10.0, 20.0, 30.0, 40.0])
    np.testing.assert_allclose(delays_ms(p, "round trip"), [32.0, 42.0, 12.5, 40.0])


def test_a_round_trip_is_lost_with_either_way():
    p = profile([1.0, -1.0, 1.0, 1.0], [1.0, 1.0, -1.0, 1.0])
    # The answer to the first leaves in period 1, that to the third in period 3.
    np.testing.assert_array_equal(
        np.isfinite(delays_ms(p, "round trip")), [True, False, True, True]
    )


def test_a_spike_is_a_stretch_of_late_or_lost_messages():
    delays = np.array([1.0, 12.0, 11.0, 1.0, math.inf, 10.0, 1.0, 1.0, 1.0, math.inf])
    found = delay_spikes(delays)
    assert [(o.first, o.last, o.messages) for o in found] == [(1, 2, 2), (4, 5, 2), (9, 9, 1)]
    assert [o.peak_ms for o in found] == [12.0, 10.0, math.inf]


@pytest.mark.parametrize("delay_ms", [0.0, 1.7, 15.0, 500.0])
def test_a_constant_delay_has_no_spike(delay_ms):
    assert delay_spikes(np.full(100, delay_ms)) == []
    of_it = statistics([load_profile(f"constant:{delay_ms}ms/{delay_ms}ms")], "uplink")
    assert of_it.median == of_it.maximum == pytest.approx(delay_ms)
    assert of_it.spikes_per_second == 0.0
    assert math.isnan(of_it.peak_median)


def test_profiles_are_pooled():
    # Two seconds in all; one loss in 2000, one spike in one and two in the other.
    quiet = np.ones(1000)
    one, other = quiet.copy(), quiet.copy()
    one[10:20] = 50.0
    other[500:540] = 80.0
    other[900] = -1.0
    of_both = statistics([profile(one, quiet), profile(other, quiet)], "uplink")
    assert of_both.lost == pytest.approx(1 / 2000)
    assert of_both.spikes_per_second == pytest.approx(3 / 2.0)
    assert of_both.maximum == 80.0
    assert of_both.peak_median == 65.0
    assert of_both.duration_median == 10.0
    assert of_both.duration_maximum == 40.0
    assert of_both.lost_maximum == 1.0


def test_a_lost_span_is_a_spike_as_long_as_it_lasted():
    up = np.ones(1000)
    up[100:400] = -1.0
    up[390] = 50.0
    of_it = statistics([profile(up, np.ones(1000))], "uplink")
    assert of_it.spikes_per_second == 1.0
    assert of_it.duration_maximum == 300.0
    assert of_it.lost_maximum == 290.0
    assert of_it.peak_median == 50.0


def test_the_autocorrelation_is_that_of_a_known_process():
    # A first-order autoregression with coefficient c has correlation c^k at lag k.
    rng = np.random.default_rng(1)
    noise = rng.normal(size=200_000)
    series = np.zeros_like(noise)
    for k in range(1, len(noise)):
        series[k] = 0.9 * series[k - 1] + noise[k]
    np.testing.assert_allclose(autocorrelation([series], 12), 0.9 ** np.arange(12), atol=0.02)


def test_the_sets_are_as_their_readme_says():
    # Read off the files by other means.
    names = [f"building/{k:03}" for k in range(1, 61)]
    down = statistics([load_profile(name) for name in names], "downlink")
    assert down.median == pytest.approx(1.74, abs=0.01)
    assert down.q99 == pytest.approx(35, abs=0.5)
    assert down.maximum == pytest.approx(119, abs=0.5)
    assert down.spikes_per_second == pytest.approx(1.45, abs=0.01)
