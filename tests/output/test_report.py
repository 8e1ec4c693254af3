from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.output.report import (
    discrepancy_report,
    edge_report,
    link_report,
    merge,
    robot_report,
)
from shared.output.summary import summary, summary_in_words
from shared.output.validity import Machine
from shared.output.versions import versions
from shared.telemetry.metrics import log_hash, quantiles
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, tick_schema

SCHEMA = tick_schema(nq=38, nv=37)
NONE = np.empty(0)


def ticks(count, *, waiting=0):
    """Rows whose numbers are easy to add up; the first `waiting` are before the task."""
    rows = np.zeros((count, SCHEMA.width))

    def put(name, values):
        rows[:, SCHEMA.slices[name]] = np.broadcast_to(values, count)[:, None]

    k = np.arange(count)
    put("tick", k)
    put("time_ns", np.where(k < waiting, -1, (k - waiting) * 1_000_000))
    put("source", np.where(k < waiting, 2, k % 2))
    put("projector_age_ns", np.where(k < waiting, -1, 500_000 + 1_000_000 * (k % 2)))
    put("com_error_m", np.where(k < waiting, 9.0, 0.01))
    put("contact_violation_m_s2", np.where(k % 2, np.nan, 0.5))
    put("tick_ns", 300_000)
    put("overruns", k)
    return rows


def robot_part(rows, **changes):
    counts: dict[str, Any] = {"fell": False, "wall_seconds": 2.0, "sent": 10, "received": 8}
    counts |= {"lost": 1, "refused": {}, "answers": {}, "sensor_faults": {}}
    counts["base_estimate"] = {"jumps": 0, "drifts": 0}
    counts["torque_limits"] = {f"joint{k}": 100.0 for k in range(31)}
    return robot_report(SCHEMA, rows, **{**counts, **changes})


def test_a_summary_says_who_answered_and_which_sensors_failed():
    answers = {"0a": {"taken": 7, "refused": 0}, "0b": {"taken": 2, "refused": 3}}
    moved = {"jumps": 2, "drifts": 0}
    part = robot_part(ticks(10), answers=answers, sensor_faults={"LKnee": 4}, base_estimate=moved)
    text = summary_in_words(
        summary(RunConfig(), robot=part, edge=None, link=None, discrepancy=None)
    )
    assert "answers from 2 edges: 7 of 0a (0 refused), 2 of 0b (3 refused)" in text
    assert "sensor faults held over: LKnee 4 ×" in text
    assert "the base's estimate moved: 2 jumps, 0 drifts; the robot did not follow it" in text
    part = robot_part(ticks(10))
    whole = summary(RunConfig(), robot=part, edge=None, link=None, discrepancy=None)
    assert "estimate" not in summary_in_words(whole)


def summary_on(machine):
    return summary(
        RunConfig(),
        robot=robot_part(ticks(10)),
        edge=None,
        link=None,
        discrepancy=None,
        machine=machine,
    )


@pytest.mark.parametrize(
    ("cores", "line"), [(1.24, "other processes took 1.2 of this machine's 2 cores"), (0.1, None)]
)
def test_the_work_of_others_on_the_machine_is_told(cores, line):
    told = summary_on(Machine(2, other_cores=cores))
    assert told["machine"]["other_cores"] == cores
    text = summary_in_words(told)
    assert f"with LA over factory/001\n  {line}\n" in text if line else "other proc" not in text


def test_the_effect_of_others_on_the_machine_is_told():
    machine = Machine(2, 0, {"p50": 8.7}, other_cores=0.6, stalls_s={"shim": 0.01, "edge": 0.057})
    told = summary_on(machine)
    assert (
        "with LA over factory/001\n"
        "  other processes took 0.6 of this machine's 2 cores; an answer left the edge 9 ms after "
        "its state (median), the longest standstill was 57 ms\n"
    ) in summary_in_words(told)


def test_quantiles_are_of_the_finite_values():
    values = np.array([*range(1, 102), np.nan, np.inf])
    assert quantiles(values) == {"p50": 51.0, "p99": 100.0, "max": 101.0}


@pytest.mark.parametrize("values", [np.empty(0), np.array([np.nan]), np.array([np.inf])])
def test_quantiles_of_nothing_are_none(values):
    assert quantiles(values) == {"p50": None, "p99": None, "max": None}


def test_quantiles_are_rounded():
    assert quantiles(np.array([1 / 3]))["p50"] == 0.3333
    assert quantiles(np.array([1 / 3]), digits=1)["max"] == 0.3


def test_a_robot_report_counts_the_ticks_of_the_task_only():
    report = robot_part(ticks(30, waiting=10))
    assert report["task_seconds"] == 0.02
    assert report["commands"] == {
        "fresh": 10,
        "cached": 10,
        "held": 0,
        "on_board": 0,
        "corrected": 0,
        "stopping": 0,
    }
    assert report["com_error_m"] == 0.01
    assert report["contact_violation_m_s2"] == 0.5
    assert report["projector_age_ms"] == {"p50": 1.0, "p99": 1.5, "max": 1.5}
    assert report["robot_tick_ms"]["max"] == 0.3
    assert report["overruns"] == 29
    assert report["realtime_factor"] == 0.01


def test_of_a_run_longer_than_its_file_the_time_is_told_and_how_much_of_it_was_measured():
    report = robot_part(ticks(40, waiting=10), wall_seconds=0.1, sent=110)
    assert (report["task_seconds"], report["measured_seconds"]) == (0.1, 0.03)
    assert report["realtime_factor"] == 1.0
    words = summary_in_words(
        summary(RunConfig(), robot=report, edge=None, link=None, discrepancy=None)
    )
    assert words.startswith("Stands after 0.10 s")
    assert "figures cover its first 0.03 s" in words


def test_a_run_that_never_began_reports_nothing_and_does_not_fail():
    report = robot_part(ticks(5, waiting=5), wall_seconds=0.0, sent=5)
    assert report["task_seconds"] == 0.0
    assert report["com_error_m"] is None
    assert report["projector_age_ms"]["p50"] is None
    assert report["realtime_factor"] is None


def test_the_hash_is_of_what_the_robot_did_and_not_of_how_long_it_took():
    rows = ticks(20)
    digest = log_hash(SCHEMA, rows)
    for name in ("tick_ns", "late_ns", "overruns", "wall_ns", "refused"):
        other = rows.copy()
        other[:, SCHEMA.slices[name]] += 1.0
        assert log_hash(SCHEMA, other) == digest
    for name in ("time_ns", "source", "q", "v", "tau"):
        other = rows.copy()
        # The smallest change there is, in the last of its numbers.
        last = SCHEMA.slices[name].stop - 1
        other[7, last] = np.nextafter(other[7, last], np.inf)
        assert log_hash(SCHEMA, other) != digest


def test_the_hash_leaves_the_wait_for_the_edge_out():
    assert robot_part(ticks(30, waiting=10))["log_hash"] != robot_part(ticks(30))["log_hash"]
    waited, prompt = ticks(30, waiting=10)[10:], ticks(30, waiting=10)
    assert robot_part(waited)["log_hash"] == robot_part(prompt)["log_hash"]


def test_an_edge_report_has_its_solve_times_and_outcomes():
    rows = np.zeros((3, SOLVE_SCHEMA.width))
    rows[:, SOLVE_SCHEMA.slices["solve_ns"]] = [[1e6], [2e6], [3e6]]
    report = edge_report(
        rows, statuses={"solved": 3}, sent=3, received=5, lost=2, refused={"stale": 1}
    )
    assert report["edge_solve_ms"]["p50"] == 2.0
    assert report["edge_solves"] == {"solved": 3}
    assert report["link"]["uplink"] == {"received": 5, "lost": 2, "refused": {"stale": 1}}
    assert report["link"]["downlink"] == {"sent": 3}


def test_a_link_report_tells_each_direction_apart_and_errors_from_delays():
    rows = np.zeros((5, LINK_SCHEMA.width))

    def put(name, values):
        rows[:, LINK_SCHEMA.slices[name]] = np.reshape(values, (5, 1))

    put("direction", [0, 0, 0, 1, 1])
    put("bytes", [700, 700, 700, 28_000, 28_000])
    put("nominal_ns", [1e6, 1e6, 0, 5e6, 7e6])
    put("achieved_ns", [1.1e6, 1.3e6, -1, 5e6, 7.5e6])
    report = link_report(rows, profile={"profile": "factory/001"}, passes=2)
    up, down = report["link"]["uplink"], report["link"]["downlink"]
    assert (report["profile"], report["profile_passes"]) == ("factory/001", 2)
    assert (up["dropped_by_profile"], down["dropped_by_profile"]) == (1, 0)
    assert up["nominal_delay_ms"]["max"] == 1.0
    assert up["delay_error_ms"]["max"] == 0.3
    assert down["delay_error_ms"]["max"] == 0.5
    assert down["bytes_per_message"]["p50"] == 28_000


def test_merging_joins_maps_and_later_values_win():
    first = {"a": 1, "m": {"x": 1, "n": {"p": 1}}}
    second = {"m": {"y": 2, "n": {"q": 2}}, "a": 3}
    assert merge(first, second) == {"a": 3, "m": {"x": 1, "y": 2, "n": {"p": 1, "q": 2}}}


def test_merging_leaves_missing_parts_out_and_its_input_alone():
    first = {"m": {"x": 1}}
    assert merge(None, first, None, {"m": {"y": 2}}) == {"m": {"x": 1, "y": 2}}
    assert first == {"m": {"x": 1}}
    assert merge() == {}


def test_a_map_and_a_value_under_one_name_do_not_mix():
    assert merge({"a": {"x": 1}}, {"a": 2}) == {"a": 2}
    assert merge({"a": 2}, {"a": {"x": 1}}) == {"a": {"x": 1}}


def test_the_discrepancy_is_told_by_cardinality_from_the_ticks_of_the_task():
    rows = ticks(6, waiting=1)
    rows[:, SCHEMA.slices["active_set"]] = np.array([[0b1000], [0], [0b11], [0b01], [0b01], [-1]])
    edge = np.zeros((6, SOLVE_SCHEMA.width))
    edge[:, SOLVE_SCHEMA.slices["state_sequence"]] = np.arange(6)[:, None]
    # The tick that waited does not count, nor the last, which used none.
    assert discrepancy_report(SCHEMA, rows, edge) == {
        **{"mean": 1.0, "p50": 1.0, "p99": 1.97, "max": 2.0},
        "ticks": [1, 2, 1],
        "com_error_m": [0.01, 0.01, 0.01],
        # Half of the ticks, those of odd number, know no violation.
        "contact_violation_m_s2": [None, 0.5, 0.5],
    }


def test_a_summary_has_every_key_even_where_a_part_is_missing():
    config = RunConfig()
    whole = summary(config, robot=robot_part(ticks(20)), edge=None, link=None, discrepancy=None)
    assert (whole["task"], whole["controller"]) == ("balance", "la")
    keys = {"sent", "received", "lost", "refused", "delay_error_ms"}
    for way in ("uplink", "downlink"):
        assert set(whole["link"][way]) >= keys
    assert whole["link"]["uplink"]["sent"] == 10
    assert whole["link"]["uplink"]["received"] is None
    assert whole["edge_solve_ms"]["p50"] is None
    assert set(whole["active_set_discrepancy"]) == set(
        discrepancy_report(SCHEMA, ticks(3), np.empty((0, SOLVE_SCHEMA.width)))
    )
    # What is written to disk.
    json.dumps(whole, allow_nan=False)


def test_a_summary_is_told_in_words_even_where_a_part_is_missing():
    begun, waiting = robot_part(ticks(20)), robot_part(ticks(5, waiting=5), sent=5)
    for part, begins in ((begun, "Stands after 0.02 s"), (waiting, "NO RESULT about the link")):
        words = summary_in_words(
            summary(RunConfig(), robot=part, edge=None, link=None, discrepancy=None)
        )
        assert words.startswith(begins)
        assert "None" not in words
    assert "slip" in summary_in_words(
        summary(RunConfig(), robot=robot_part(ticks(20)), edge=None, link=None, discrepancy=None)
    )
    fell = summary(
        RunConfig(),
        robot=robot_part(ticks(20), fell=True),
        edge=None,
        link=None,
        discrepancy=None,
    )
    assert summary_in_words(fell).startswith("FELL after 0.02 s")
    # A foot that is thrown about has not slipped.
    assert "slip" not in summary_in_words(fell)


@pytest.mark.parametrize(("controller", "waits"), [("la", True), ("lc", False)])
def test_a_switch_is_told_to_wait_for_a_projector_where_it_does(controller, waits):
    words = summary_in_words(
        summary(
            load_config(None, {"task": "walk", "controller": controller}),
            robot=robot_part(ticks(20)),
            edge=None,
            link=None,
            discrepancy=None,
        )
    )
    assert ("first fresh projector" in words) == waits
    assert "QPs solved on board" in words


def test_versions_name_what_results_depend_on():
    found = versions()
    for name in ("python", "platform", "pin", "mujoco", "daqp", "numpy", "eclipse-zenoh"):
        assert found[name]
