"""Computations timed in a trial: whose they are, what they add up to, and what is put back."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from benchmarks import core
from benchmarks.in_loop import EDGE, NODES, RECORD, WHOLE, Part, Stopwatch, ticks, timed_calls
from robot_node.node import RobotNode

# Whichever trial has them: one solves on the edge, the other corrects on the robot.
WITHIN_LA = {"terms of b", "b", "decode a projector", "QP and projector", "solver", "row"}
WITHIN_LC = {"correction", "decode factorisations", "terms of A"}


@pytest.fixture(scope="module")
def calls():
    parts = (*NODES, *core.PARTS)
    return {
        controller: timed_calls(
            parts, "balance", controller, seconds=0.2, clock=time.perf_counter_ns
        )
        for controller in ("la", "lc")
    }


def test_a_call_is_named_by_what_it_is_within():
    clock = itertools.count().__next__
    stopwatch = Stopwatch(clock)
    whole = Part("shared.output.text_table:aligned", "table")
    with stopwatch.on([whole]):
        from shared.output import text_table

        text_table.aligned([["a"]])
    text_table.aligned([["a"]])
    assert stopwatch.calls == [(("table",), 1)]


def test_what_was_timed_is_as_before_afterwards(calls):
    assert RobotNode.measure.__qualname__ == "RobotNode.measure"


def test_to_record_is_what_ends_a_tick_but_the_plant():
    tick = [
        (("measure",), 10),
        (("receive",), 1),
        (("receive",), 2),
        (("command",), 20),
        (("advance", "plant"), 100),
        (("advance",), 107),
        (("edge: receive",), 3),
        (("edge: step",), 4),
    ]
    warm = ticks(tick * 101)
    assert {name: durations.tolist() for name, durations in warm.items()} == {
        "measure": [10], "receive": [3], "command": [20], RECORD: [7], WHOLE: [40], EDGE: [7],
    }  # fmt: skip


def test_a_row_that_is_filled_apart_is_recording_too():
    tick = [(("record",), 5), (("advance", "plant"), 100), (("advance",), 107)]
    assert ticks(tick * 101)[RECORD].tolist() == [12]


@pytest.mark.parametrize(("controller", "within"), [("la", WITHIN_LA), ("lc", WITHIN_LC)])
def test_the_parts_of_the_table_are_done_in_trials(calls, controller, within):
    names = {path[-1] for path, _ in calls[controller]}
    assert within | {part.name for part in NODES} <= names


def test_every_part_of_the_table_can_be_found():
    for part in core.PARTS:
        owner, name = part.find()
        assert callable(vars(owner)[name])


def test_parts_take_no_longer_than_what_they_are_parts_of(calls):
    total: dict[tuple[str, ...], int] = {}
    for path, duration in calls["la"]:
        total[path] = total.get(path, 0) + duration
    for path, duration in total.items():
        assert sum(each for other, each in total.items() if other[:-1] == path) <= duration


def test_the_edge_makes_one_step_for_a_state(calls):
    steps = [path for path, _ in calls["la"] if path == ("edge: step",)]
    measured = [path for path, _ in calls["la"] if path == ("measure",)]
    # Those on their way at the end are not answered any more.
    assert 0 <= len(measured) - len(steps) < 50
    assert all(np.all(each >= 0) for each in ticks(calls["la"]).values())
