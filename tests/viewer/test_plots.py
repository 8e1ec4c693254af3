"""Series: what is kept of a 1 kHz signal, and the one time axis they share."""

from __future__ import annotations

import numpy as np

from shared.robots import Robot
from tests.viewer.synthetic import link_rows, solve_rows, tick_rows
from viewer.plots import (
    BUCKET_NS,
    MAX_COM_ERROR_CM,
    SOLVE_SERIES,
    TICK_SERIES,
    link_delay,
    peak_rows,
)
from viewer.task_time import TaskTime

MILLISECOND = 1_000_000


def test_a_spike_of_one_tick_survives_the_thinning(rng: np.random.Generator) -> None:
    times = np.arange(5000) * MILLISECOND
    values = rng.normal(size=(5000, 1))
    values[1234], values[3210] = 50.0, -50.0
    kept = peak_rows(times, values)
    assert {1234, 3210} <= set(kept)
    assert len(kept) <= 2 * 5000 * MILLISECOND / BUCKET_NS
    assert (np.diff(times[kept]) > 0).all()


def test_peaks_are_found_beside_absent_values_and_an_absent_bucket_stays_a_gap() -> None:
    times = np.arange(30) * MILLISECOND
    values = np.ones((30, 1))
    values[10:20] = np.nan
    values[3], values[4], values[5] = np.nan, 7.0, -7.0
    kept = peak_rows(times, values)
    assert {4, 5} <= set(kept)
    assert np.isnan(values[kept]).any(), "the absent bucket must not be bridged by a line"


def test_every_column_keeps_its_own_peaks_whatever_the_order_of_rows() -> None:
    times = np.arange(20)[::-1] * MILLISECOND
    values = np.zeros((20, 2))
    values[2, 0] = values[7, 1] = 9.0
    kept = peak_rows(times, values)
    assert {2, 7} <= set(kept)
    assert (np.diff(times[kept]) > 0).all()


def test_no_rows_make_no_points() -> None:
    assert len(peak_rows(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))) == 0


def test_values_are_in_the_units_of_the_plots(robot: Robot) -> None:
    schema, rows = tick_rows(robot, 2)
    rows[:, schema.slices["projector_age_ns"]] = [[-1], [30e6]]
    rows[:, schema.slices["com_error_m"]] = 0.02
    series = {each.path: each for each in TICK_SERIES}
    np.testing.assert_allclose(
        series["plots/projector_age"].values(schema, rows), [[np.nan], [30.0]]
    )
    np.testing.assert_allclose(series["plots/com_error"].values(schema, rows), 2.0)
    rows[:, schema.slices["com_error_m"]] = 1e9
    np.testing.assert_allclose(series["plots/com_error"].values(schema, rows), MAX_COM_ERROR_CM)
    schema, rows = link_rows(2, lost_every=2)
    np.testing.assert_allclose(link_delay(schema, rows)[[0, 2], 0], [np.nan, 15.1])
    schema, rows = solve_rows(1)
    np.testing.assert_allclose(SOLVE_SERIES.values(schema, rows), [[0.9]])


def test_messages_get_the_task_time_of_the_rows_around_them() -> None:
    clock = TaskTime()
    assert not clock.known
    wall = 9_000_000_000_000 + np.arange(1000) * MILLISECOND
    # A stall of 70 ms in the middle: the clock ran on, the task did not.
    wall[500:] += 70 * MILLISECOND
    clock.learn(wall, np.arange(1000) * MILLISECOND)
    at = clock.from_wall(wall[[0, 300, 800, 999]]).task_ns
    np.testing.assert_allclose(at, np.array([0, 300, 800, 999]) * MILLISECOND, atol=1)
    beyond = clock.from_wall(np.array([wall[0] - 5 * MILLISECOND, wall[-1] + 5 * MILLISECOND]))
    np.testing.assert_array_equal(beyond.task_ns, np.array([-5, 1004]) * MILLISECOND)
    # Without a stall: what the clock showed since the robot's first row.
    np.testing.assert_array_equal(np.diff(beyond.wall_ns), wall[-1] - wall[0] + 10 * MILLISECOND)
