from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netem.capacity import CapacityProfile, capacity_of
from netem.networks import load_network, load_profile, shipped_names
from netem.profile import DOWNLINK, LOST, UPLINK, DelayProfile
from shared.errors import ProfileError

MS = 1_000_000
UNBOUNDED = 2**40


def link(capacity, *, base_ns=0):
    both = np.tile(np.asarray(capacity, dtype=float), (2, 1))
    return CapacityProfile("link", both, np.array([base_ns, base_ns]), MS, {})


def replay(profile, sizes, *, direction=UPLINK, queue_bytes=UNBOUNDED, every_ns=MS):
    source = profile.source(direction, queue_bytes=queue_bytes)
    return np.array([source(k * every_ns, size) for k, size in enumerate(sizes)])


def recorded(delays_ms, *, size, **columns):
    delays = np.array(delays_ms, dtype=float)
    both = np.tile(np.where(delays < 0, LOST, np.rint(delays * MS)).astype(np.int64), (2, 1))
    metadata = {"uplink_bytes": size, "downlink_bytes": size}
    return DelayProfile("recorded", both, metadata=metadata, columns=columns)


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.lists(st.integers(0, 50), min_size=2, max_size=12).filter(any),
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=12),
)
def test_a_queue_is_that_of_a_byte_by_byte_simulation(capacity, sizes):
    delays = replay(link(capacity), sizes)
    # A server that takes one hundredth of a period at a time, the profile repeated for as long
    # as it takes: it can be late by one such part, and a byte that is shared by two.
    waiting: list[list[float]] = []
    left: dict[float, int] = {}
    part, now = 100, 0
    while len(left) < len(sizes):
        period, within = divmod(now, part)
        if within == 0 and period < len(sizes):
            waiting.append([period, float(sizes[period])])
        room = capacity[period % len(capacity)] / part
        while waiting and room > 0.0:
            served = min(room, waiting[0][1])
            waiting[0][1] -= served
            room -= served
            if waiting[0][1] <= 1e-9:
                left[waiting.pop(0)[0]] = now + 1
        now += 1
    expected = np.array([(left[k] - k * part) * MS / part for k in range(len(sizes))])
    # Serving the rest of a part to the next message is exact but for where in the part it ends.
    np.testing.assert_allclose(delays, expected, atol=1.01 * MS / part)


def test_a_message_on_an_idle_link_takes_its_own_bytes_and_the_base_delay():
    delays = replay(link([100.0], base_ns=2 * MS), [25, 25, 100])
    np.testing.assert_array_equal(delays, [2.25 * MS, 2.25 * MS, 3 * MS])


def test_what_waits_for_a_blockage_to_end_leaves_at_the_rate_of_the_link():
    delays = replay(link([0.0] * 10 + [100.0] * 10), [50] * 10)
    # Nothing until 10 ms; then one message each half millisecond.
    np.testing.assert_allclose(delays, [(10.5 + 0.5 * k - k) * MS for k in range(10)])


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.lists(st.integers(0, 50), min_size=2, max_size=12).filter(any),
    sizes=st.lists(st.tuples(st.integers(1, 60), st.integers(0, 60)), min_size=1, max_size=20),
)
def test_who_sends_less_never_waits_longer(capacity, sizes):
    less = replay(link(capacity), [size for size, _ in sizes])
    more = replay(link(capacity), [size + further for size, further in sizes])
    assert np.all(less <= more + 1)


def test_a_full_queue_loses_what_comes_last():
    delays = replay(link([0.0] * 9 + [100.0]), [10] * 9, queue_bytes=45)
    assert list(delays[:4] != LOST) == [True] * 4
    assert list(delays[4:]) == [LOST] * 5


def test_what_a_full_queue_lost_takes_no_place_in_it():
    link_of_two = link([0.0, 0.0, 0.0, 30.0])
    bounded = replay(link_of_two, [20, 20, 20], queue_bytes=20)
    alone = replay(link_of_two, [20])
    assert bounded[0] == alone[0]
    assert list(bounded[1:]) == [LOST, LOST]


@pytest.mark.parametrize("name", shipped_names()[::12])
def test_replaying_the_recorded_load_gives_back_the_recorded_delays(name):
    profile = load_profile(name)
    capacity = load_network(f"capacity:{name}")
    assert capacity.name == f"capacity:{name}"
    assert capacity.duration_ns == profile.duration_ns
    assert capacity.start_offset_ns(7) == profile.start_offset_ns(7)
    for way, size in ((UPLINK, 1000), (DOWNLINK, 40_000)):
        replayed = replay(capacity, [size] * 6000, direction=way, queue_bytes=20 * 2**20)
        known = profile.delays_ns[way]
        # What leaves after the recording ended tells nothing of the link; what was lost, neither.
        compared = (known != LOST) & (np.arange(6000) + known / MS < 6000) & (replayed != LOST)
        error_ms = np.abs(replayed - known)[compared] / MS
        # A slot of the radio is an eighth of a millisecond.
        assert np.quantile(error_ms, 0.5) <= 0.125
        # A period is a millisecond long: within it, when a byte was carried is not known.
        assert np.quantile(error_ms, 0.98) < 1.0


def test_bytes_were_carried_when_the_physical_layer_says():
    # One message caught for 20 ms; the link carried something half-way.
    delays = [0.0] * 10 + [20.0 - k for k in range(20)] + [0.0] * 10
    delivered = np.zeros(40)
    delivered[[18, 29]] = 500
    known = capacity_of(recorded(delays, size=1000, delivered_ul_bytes=delivered)).capacity[0]
    unknown = capacity_of(recorded(delays, size=1000)).capacity[0]
    assert known[18] > 400
    assert known[11:18].sum() == 0
    assert unknown[11:29].sum() == 0
    np.testing.assert_allclose(known[10:30].sum(), unknown[10:30].sum())


def test_a_profile_that_says_its_capacity_is_taken_at_its_word():
    given = np.linspace(100, 400, 4)
    profile = recorded(
        [1.0] * 4, size=1, uplink_capacity_bytes=given, downlink_capacity_bytes=given[::-1]
    )
    capacity = capacity_of(profile).capacity
    np.testing.assert_array_equal(capacity, [given, given[::-1]])


def test_a_profile_of_unknown_sizes_is_refused_with_what_it_lacks():
    profile = DelayProfile("mine", np.full((2, 4), MS, dtype=np.int64))
    with pytest.raises(ProfileError, match="uplink_capacity_bytes, or how many bytes"):
        capacity_of(profile)


def test_a_link_that_carries_nothing_is_refused():
    nothing = np.zeros(4)
    profile = recorded(
        [1.0] * 4, size=1, uplink_capacity_bytes=nothing, downlink_capacity_bytes=nothing
    )
    with pytest.raises(ProfileError, match="expected bytes that the uplink carries, got none"):
        capacity_of(profile)


@pytest.mark.parametrize(
    "metadata",
    [
        {"rate_hz": 100},
        {"packets": {"uplink": 5, "downlink": 50}},
        {"packets": {"uplink": 500, "downlink": 500}, "interpolated": {"uplink": 0.5}},
    ],
    ids=["rate", "packets", "bursts"],
)
def test_a_load_of_less_than_a_message_a_period_tells_no_capacity(metadata):
    slow = recorded([5.0] * 50, size=1000)
    slow.metadata.update(metadata)
    with pytest.raises(ProfileError, match="a message in every period of 1 ms, got"):
        capacity_of(slow)
    # Told by itself, the capacity needs no messages.
    given = {f"{way}_capacity_bytes": np.full(50, 1000.0) for way in ("uplink", "downlink")}
    told = recorded([5.0] * 50, size=1000, **given)
    told.metadata.update(metadata)
    assert capacity_of(told).capacity.sum() == 100_000


@pytest.mark.parametrize(
    "metadata", [{"rate_hz": 1000}, {"rate_hz": "often"}, {"packets": 7}, {"packets": {}}]
)
def test_a_message_a_period_or_nothing_said_of_it_is_enough(metadata):
    fast = recorded([5.0] * 50, size=1000)
    fast.metadata.update(metadata)
    assert capacity_of(fast).capacity.shape == (2, 50)
