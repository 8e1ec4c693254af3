"""The paper's comparison in short trials, and the age of what the robot uses."""

from __future__ import annotations

import numpy as np
import pytest

MS = 1_000_000
PERIOD_NS, DEADLINE_NS = 1 * MS, 500_000


def column(result, name):
    return result.schema.column(result.rows, name)


def running(result):
    """Which rows belong to the task."""
    return column(result, "time_ns") >= 0


@pytest.fixture(scope="module")
def assisted_90(play):
    return play(duration=3.0, controller="la", **{"link.network": "constant:90ms"})


def test_locally_assisted_stands_a_push_at_ninety_milliseconds(assisted_90):
    summary = assisted_90.summary
    assert not summary["fell"]
    assert summary["task_seconds"] == 3.0
    # 2.08 cm measured over 5 s; the paper's Table II has 2.5 cm. Without delay it is 1.56 cm.
    assert summary["com_error_m"] <= 0.026


def test_purely_remote_falls_under_the_same_push_at_fifty_milliseconds(play):
    result = play(duration=5.0, controller="pr", **{"link.network": "constant:50ms"})
    assert result.summary["fell"]
    # The push is from 1.0 s to 1.2 s: it falls because of it, not before it.
    assert 1.1 < result.summary["task_seconds"] < 3.0
    assert np.isfinite(result.rows[:, result.schema.slices["tau"]]).all()


def test_purely_remote_stands_the_push_without_delay(play):
    result = play(duration=2.0, controller="pr", **{"link.network": "constant:0ms"})
    assert not result.summary["fell"]


def test_a_single_precision_projector_stands_as_well(play, assisted_90):
    result = play(
        duration=1.5, **{"link.network": "constant:90ms", "wire.projector_dtype": "float32"}
    )
    assert not result.summary["fell"]
    # Rounding of 1e-7 of the torque, below any sensor: the same path to a hundredth of a millimetre
    # until the push is over.
    single = column(result, "com")[running(result)]
    double = column(assisted_90, "com")[running(assisted_90)][: len(single)]
    np.testing.assert_allclose(single, double, atol=1e-5)
    half, whole = (
        each.summary["link"]["downlink"]["bytes_per_message"]["max"]
        for each in (result, assisted_90)
    )
    assert half < 0.55 * whole


@pytest.mark.parametrize(
    ("network", "round_trip_ms"),
    [
        ("constant:0ms", 0.0),
        ("constant:200us", 0.2),
        ("constant:201us", 0.201),
        ("constant:7ms", 7.0),
        ("constant:1ms/9ms", 10.0),
        ("constant:9ms/1ms", 10.0),
        ("constant:33.3ms", 33.3),
    ],
)
@pytest.mark.parametrize("compute_ns", [0, 300_000, 900_000])
def test_the_age_of_a_projector_is_the_round_trip_to_the_next_tick(
    play, network, round_trip_ms, compute_ns
):
    result = play(
        duration=0.05, push=[], **{"link.network": network, "loop.edge_compute_ns": compute_ns}
    )
    ages = column(result, "projector_age_ns")[running(result)]
    path_ns = round(round_trip_ms * MS) + compute_ns
    # It arrives path_ns after its measurement and is used at the next k · period + d*.
    ticks = max(0, -(-(path_ns - DEADLINE_NS) // PERIOD_NS))
    np.testing.assert_array_equal(ages, ticks * PERIOD_NS + DEADLINE_NS)
    assert ages.max() < max(path_ns + PERIOD_NS, DEADLINE_NS + 1)
    fresh = result.summary["commands"]["fresh"]
    assert fresh == (50 if ticks == 0 else 0)


def test_an_edge_slower_than_the_tick_answers_the_newest_state_and_nothing_piles_up(play):
    compute_ns = 2_300_000
    result = play(
        duration=0.3,
        push=[],
        **{"link.network": "constant:4ms", "loop.edge_compute_ns": compute_ns},
    )
    ages = column(result, "projector_age_ns")[running(result)]
    # At worst a state waits for a solve to end, is solved, and its answer is used until the next.
    assert ages.max() <= 4 * MS + 3 * compute_ns + PERIOD_NS
    # The age at the end is that of the beginning: no queue grows.
    assert ages[-50:].max() == ages[:50].max()
    solves = len(result.solve_rows)
    assert solves == pytest.approx(300 * PERIOD_NS / compute_ns, rel=0.05)


def test_the_robot_waits_for_its_first_projector_without_moving(play, robot):
    result = play(duration=0.05, push=[], **{"link.network": "constant:20ms"})
    before = ~running(result)
    assert before.sum() == 20
    for q in column(result, "q")[before]:
        np.testing.assert_allclose(q, robot.q_standing, atol=1e-15)
    assert column(result, "time_ns")[running(result)][0] == 0
    assert result.summary["task_seconds"] == 0.05


def test_every_message_has_the_delay_of_the_profile(play):
    result = play(duration=0.3, push=[], **{"link.network": "constant:3ms/8ms"})
    for name, delay_ms in (("uplink", 3.0), ("downlink", 8.0)):
        way = result.summary["link"][name]
        assert way["nominal_delay_ms"] == {"p50": delay_ms, "p99": delay_ms, "max": delay_ms}
        assert way["delay_error_ms"]["max"] == 0.0
        assert way["dropped_by_profile"] == way["lost"] == 0
        assert way["refused"] == {}


def test_messages_respect_their_size_bounds(assisted_90):
    link = assisted_90.summary["link"]
    assert 0 < link["uplink"]["bytes_per_message"]["max"] <= 1_000
    assert 0 < link["downlink"]["bytes_per_message"]["max"] <= 40_000


def test_torques_stay_within_the_clamp_through_a_push_and_a_fall(play, robot, assisted_90):
    fall = play(duration=5.0, controller="pr", **{"link.network": "constant:50ms"})
    for result in (assisted_90, fall):
        # A rounding of the product clamp · effort is the same on both sides: no tolerance.
        assert np.all(np.abs(column(result, "tau")) <= 1.45 * robot.effort_limit)


def test_a_run_over_a_measured_path_stands(play):
    result = play(duration=2.0, **{"link.network": "factory/003"})
    assert not result.summary["fell"]
    assert result.summary["commands"]["cached"] > 1600
