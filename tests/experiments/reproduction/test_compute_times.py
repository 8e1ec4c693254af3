"""Table V on a second of each walk: what is measured, not how long it takes."""

from __future__ import annotations

import gc
import json
import os

import numpy as np
import pytest

from experiments.reproduction import compute_times
from experiments.reproduction.compute_times import (
    EDGE_STEP,
    FULL_CONTROLLER,
    LOCAL,
    QP,
    ROBOT_TICK,
    ComputeTimes,
    Time,
)


@pytest.fixture(scope="module")
def measured():
    return compute_times.measure(repetitions=1, seconds=1.0)


def test_every_computation_is_timed_at_every_tick_after_the_warm_up(measured):
    for name in (QP, FULL_CONTROLLER, *LOCAL.values(), *ROBOT_TICK.values()):
        # 200 ticks warm up; a few more stand before the first answer begins the task.
        assert 800 <= measured.time(name).calls < 810, name
    assert {each.name for each in measured.times} > set(EDGE_STEP.values())


def test_a_part_takes_less_than_the_whole(measured):
    assert measured.time(QP).mean_ms < measured.time(FULL_CONTROLLER).mean_ms
    for name in LOCAL:
        assert measured.time(LOCAL[name]).mean_ms < measured.time(ROBOT_TICK[name]).mean_ms


def test_a_line_has_the_times_and_the_same_scaled(measured):
    for each, line in zip(measured.times, measured.rows(), strict=True):
        assert len(line) == len(measured.columns)
        assert line[0] == each.name
        assert line[1] == f"{each.mean_ms:.3f}"
        assert line[5] == f"{3.08 * each.mean_ms:.3f}"


def test_the_messages_are_those_of_both_directions_and_lc_sends_fewest_down(measured):
    down = {m.controller: m for m in measured.messages if m.direction == "downlink"}
    assert len(measured.messages) == 6
    assert len(measured.message_rows()[0]) == len(measured.message_columns)
    assert 0.0 < down["lc"].per_second < 0.2 * down["la"].per_second
    assert 12_000 < down["la"].mean_bytes <= down["la"].most_bytes


def test_the_times_survive_json(measured):
    assert ComputeTimes.from_json(json.loads(json.dumps(measured.as_json()))) == measured


def test_the_undisturbed_worst_is_that_of_the_least_repetitions():
    time = Time.of("a", np.array([[1e6, 9e6, 2e6], [1e6, 2e6, 3e6]]))
    assert (time.calls, time.worst_ms, time.undisturbed_worst_ms) == (6, 9.0, 2.0)


def test_cores_and_garbage_collection_are_given_back(monkeypatch):
    before = os.sched_getaffinity(0)

    def fail(*_, **__):
        assert not gc.isenabled()
        assert len(os.sched_getaffinity(0)) == 1
        raise RuntimeError

    monkeypatch.setattr(compute_times, "TimedWalk", fail)
    with pytest.raises(RuntimeError):
        compute_times.measure(repetitions=1)
    assert os.sched_getaffinity(0) == before
    assert gc.isenabled()
