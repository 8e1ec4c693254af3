"""A run is a result about the link only if the machine kept up and answers were fresh enough."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shared.config.config_file import load_config
from shared.output.validity import Machine, edge_ms, invalid_reasons, shim_ms, stalls_s
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, tick_schema

TICKS = tick_schema(nq=38, nv=37)
MS = 1_000_000
# As measured on two slow cores with nothing else to do.
IDLE = Machine(2, 0, {"p50": 4.0}, {"uplink": {"p50": 0.1}, "downlink": {"p50": 0.3}})


def a_summary(**changes: Any) -> dict[str, Any]:
    return {
        "network": "factory/001",
        "measured_seconds": 5.0,
        "realtime_factor": 1.0,
        "overruns": 450,
        "answers_used": 1800,
        "commands": {"held": 0},
        "link": {
            "uplink": {"sent": 5000, "received": 5000},
            "downlink": {"sent": 1850, "received": 1850},
        },
        **changes,
    }


def reasons(machine: Machine | None = IDLE, controller: str = "la", **changes: Any) -> list[str]:
    config = load_config(None, {"controller": controller})
    return invalid_reasons(a_summary(**changes), config, machine)


def test_a_run_on_an_idle_slow_machine_is_a_result() -> None:
    assert reasons() == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"realtime_factor": 0.28}, "simulated time ran at 0.28 × real time"),
        ({"overruns": 4800}, "96 % of the ticks ended too late"),
        (
            {"machine": Machine(2, 0, {"p50": 22.0}, IDLE.shim_ms)},
            "the edge answered 37 % of the states, 22 ms after they came (median)",
        ),
        (
            {"machine": Machine(2, 0, IDLE.edge_ms, {"uplink": {"p50": 390.0}})},
            "the uplink was 390 ms longer than the profile (median)",
        ),
    ],
)
def test_a_machine_that_was_too_slow_is_told_with_its_measure(
    changes: dict[str, Any], words: str
) -> None:
    assert reasons(**changes) == [f"the machine was too slow: {words}"]


@pytest.mark.parametrize(
    ("cores", "others", "words"),
    [
        (2, 1, ["a second stack ran beside it on 2 cores"]),
        (4, 2, ["2 other stacks ran beside it on 4 cores"]),
        (4, 1, []),
        (1, 0, []),
    ],
)
def test_another_stack_counts_where_there_are_too_few_cores_for_both(
    cores: int, others: int, words: list[str]
) -> None:
    assert reasons(Machine(cores, others)) == words


def test_under_simulated_time_the_speed_of_the_machine_does_not_count() -> None:
    assert reasons(None, realtime_factor=0.01, overruns=4000) == []


@pytest.mark.parametrize("machine", [None, IDLE])
def test_answers_that_were_never_fresh_enough_are_no_result(machine: Machine | None) -> None:
    held: dict[str, Any] = {"answers_used": 0, "commands": {"held": 4900}}
    [reason] = reasons(machine, **held)
    assert reason.startswith("no answer was ever fresh enough: ")
    assert "older than 500 ms (loop.hold_after)" in reason
    # LC does without fresh answers, and a short run may end before the first.
    assert reasons(machine, "lc", **held) == []
    assert reasons(machine, answers_used=0) == []


def test_a_link_of_too_small_a_capacity_is_named() -> None:
    ways: dict[str, Any] = {"uplink": {"sent": 100, "received": 100}}
    ways["downlink"] = {"sent": 100, "received": 3, "bytes_per_message": {"p50": 28_309.0}}
    [reason] = reasons(
        network="capacity:mine.csv", answers_used=0, commands={"held": 90}, link=ways
    )
    assert "the downlink carried 3 of 100 messages of 28309 B" in reason


def test_the_edges_time_is_from_a_states_arrival_to_an_answer_at_least_as_new() -> None:
    link = np.zeros((6, LINK_SCHEMA.width))
    link[:, LINK_SCHEMA.slices["sequence"]] = np.arange(6)[:, None]
    link[:, LINK_SCHEMA.slices["wall_ns"]] = (np.arange(6) * MS)[:, None]
    link[:, LINK_SCHEMA.slices["nominal_ns"]] = 2 * MS
    # What the shim adds counts too; state 3 was lost on the link, and does not.
    link[:, LINK_SCHEMA.slices["achieved_ns"]] = 3 * MS
    link[3, LINK_SCHEMA.slices["achieved_ns"]] = -1
    solves = np.zeros((2, SOLVE_SCHEMA.width))
    solves[:, SOLVE_SCHEMA.slices["state_sequence"]] = [[1], [4]]
    solves[:, SOLVE_SCHEMA.slices["wall_ns"]] = [[4 * MS], [9 * MS]]
    solves[:, SOLVE_SCHEMA.slices["solve_ns"]] = MS
    # States 0 and 1 come at 2 and 3 ms, answered at 5; 2 and 4 at 4 and 6, answered at 10; 5 never.
    found = edge_ms(TICKS, np.empty((0, TICKS.width)), link, solves)
    assert found["p50"] == np.median([3.0, 2.0, 6.0, 4.0])
    assert found["max"] == 6.0


def test_without_a_shim_a_state_reaches_the_edge_when_it_is_measured() -> None:
    ticks = np.zeros((3, TICKS.width))
    ticks[:, TICKS.slices["tick"]] = np.arange(3)[:, None]
    ticks[:, TICKS.slices["wall_ns"]] = (np.arange(3) * MS)[:, None]
    solves = np.zeros((1, SOLVE_SCHEMA.width))
    solves[:, SOLVE_SCHEMA.slices["state_sequence"]] = 2
    solves[:, SOLVE_SCHEMA.slices["wall_ns"]] = 5 * MS
    assert edge_ms(TICKS, ticks, None, solves) == {"p50": 4.0, "p99": 4.98, "max": 5.0}


def test_messages_that_waited_in_an_outage_do_not_make_the_shim_late() -> None:
    link = np.zeros((100, LINK_SCHEMA.width))
    nominal_ms = np.where(np.arange(100) < 60, np.arange(100) * 10.0 + 60.0, 2.0)
    late_ms = np.where(np.arange(100) < 60, 300.0, 0.2)
    link[:, LINK_SCHEMA.slices["nominal_ns"]] = (nominal_ms * MS)[:, None]
    link[:, LINK_SCHEMA.slices["achieved_ns"]] = ((nominal_ms + late_ms) * MS)[:, None]
    found = shim_ms(link)
    assert found["uplink"]["max"] == 0.2
    assert found["downlink"]["max"] is None


def link_of(sequence: np.ndarray, late_ms: Any = 0.0) -> np.ndarray:
    """States sent a millisecond apart, and released `late_ms` after their delay of 5 ms."""
    link = np.zeros((len(sequence), LINK_SCHEMA.width))
    link[:, LINK_SCHEMA.slices["sequence"]] = sequence[:, None]
    link[:, LINK_SCHEMA.slices["wall_ns"]] = (sequence * MS)[:, None]
    link[:, LINK_SCHEMA.slices["nominal_ns"]] = 5 * MS
    link[:, LINK_SCHEMA.slices["achieved_ns"]] = np.reshape((5 + late_ms) * MS, (-1, 1))
    return link


def solves_of(sequence: np.ndarray) -> np.ndarray:
    """Answers to these states, each 2 ms after its arrival."""
    solves = np.zeros((len(sequence), SOLVE_SCHEMA.width))
    solves[:, SOLVE_SCHEMA.slices["state_sequence"]] = sequence[:, None]
    solves[:, SOLVE_SCHEMA.slices["wall_ns"]] = ((sequence + 6) * MS)[:, None]
    solves[:, SOLVE_SCHEMA.slices["solve_ns"]] = MS
    return solves


def a_task(count: int) -> np.ndarray:
    ticks = np.zeros((count, TICKS.width))
    ticks[:, TICKS.slices["tick"]] = np.arange(count)[:, None]
    ticks[:, TICKS.slices["wall_ns"]] = (np.arange(count) * MS)[:, None]
    return ticks


ALL = np.arange(1000)


@pytest.mark.parametrize(
    ("link", "solves", "part", "seconds"),
    [
        (link_of(ALL), solves_of(ALL), None, 0.0),
        # The shim missed 400 states.
        (link_of(ALL[(ALL < 300) | (ALL >= 700)]), solves_of(ALL), "uplink", 0.4),
        # The shim stopped: 300 states without the 5 ms of the last ones.
        (link_of(ALL[:700]), solves_of(ALL), "end", 0.295),
        (link_of(ALL, np.where(ALL == 500, 350.0, 0.0)), solves_of(ALL), "shim", 0.35),
        # State 100 comes at 105 ms; the next answer leaves at 607 ms.
        (link_of(ALL), solves_of(ALL[(ALL < 100) | (ALL >= 600)]), "edge", 0.502),
        # No answer after that to state 399, until the end of the run.
        (link_of(ALL), solves_of(ALL[:399]), "edge", 0.595),
    ],
)
def test_the_longest_standstill_of_each_part_is_found(
    link: np.ndarray, solves: np.ndarray, part: str | None, seconds: float
) -> None:
    found = stalls_s(TICKS, a_task(1000), link, solves)
    assert found[part or "shim"] == pytest.approx(seconds, abs=0.002)
    assert all(found[other] < 0.02 for other in {"uplink", "end", "shim"} - {part})
    told = reasons(Machine(2, 0, IDLE.edge_ms, IDLE.shim_ms, stalls_s=found))
    assert bool(told) == (part is not None)
    assert part is None or f"for {found[part]:.2f} s" in told[0]


def test_a_standstill_in_the_slower_direction_is_found() -> None:
    # A state on a link of 5 ms and its answer on one of 60 ms, which the shim releases 350 ms late.
    link = link_of(np.zeros(2), np.array([0.0, 350.0]))
    link[1, LINK_SCHEMA.slices["direction"]] = 1
    for delay in ("nominal_ns", "achieved_ns"):
        link[1, LINK_SCHEMA.slices[delay]] += 55 * MS
    assert stalls_s(TICKS, a_task(1000), link, None)["shim"] == pytest.approx(0.35)
    assert shim_ms(link)["downlink"]["max"] == 350.0


def test_a_forged_number_neither_hides_nor_makes_a_standstill() -> None:
    # The shim stopped at 700 ms; at 300 ms came a message with the number of no tick.
    link = link_of(np.append(ALL[:700], 300))
    link[-1, LINK_SCHEMA.slices["sequence"]] = 2**31
    found = stalls_s(TICKS, a_task(1000), link, solves_of(ALL))
    assert found["end"] == pytest.approx(0.295)
    assert found["edge"] == pytest.approx(0.002)


def test_an_outage_of_the_link_is_no_standstill() -> None:
    link = link_of(ALL)
    waited = np.where((ALL >= 300) & (ALL < 700), 705 - ALL, 5)
    link[:, LINK_SCHEMA.slices["nominal_ns"]] = (waited * MS)[:, None]
    link[:, LINK_SCHEMA.slices["achieved_ns"]] = (waited * MS)[:, None]
    link[200, LINK_SCHEMA.slices["achieved_ns"]] = -1
    solves = solves_of(ALL[(ALL < 300) | (ALL >= 700)])
    assert max(stalls_s(TICKS, a_task(1000), link, solves).values()) < 0.02
    # Nothing is released after an outage at the end of the profile has begun.
    ending = Machine(2, stalls_s=stalls_s(TICKS, a_task(1000), link[:600], None))
    assert reasons(ending) == []
    short: dict[str, Any] = {"profile_worst_outage": {"ms": 400.0}}
    at_end = Machine(2, stalls_s={"end": 0.6})
    assert reasons(at_end, **short) == []
    assert reasons(at_end) == [
        "the machine was too slow: the shim released no state before the end for 0.60 s"
    ]


def test_an_edge_that_answers_seldom_does_not_stand_still_in_an_outage() -> None:
    answered = ALL[(ALL % 100 == 0) & ((ALL < 300) | (ALL >= 700))]
    # The states of the outage are lost, or all arrive at its end.
    for nominal_ms, achieved_ms in ((5 + 0 * ALL, -1), (705 - ALL, 705 - ALL)):
        link = link_of(ALL)
        out = (ALL >= 300) & (ALL < 700)
        link[:, LINK_SCHEMA.slices["nominal_ns"]] = (np.where(out, nominal_ms, 5) * MS)[:, None]
        achieved_ns = np.where(out, achieved_ms, 5) * MS
        link[:, LINK_SCHEMA.slices["achieved_ns"]] = achieved_ns[:, None]
        found = stalls_s(TICKS, a_task(1000), link, solves_of(answered))
        # State 201 came 99 ms before the outage.
        assert found["edge"] == pytest.approx(0.1, abs=0.01)
        assert found["shim"] == 0.0
    # The link is cut until the end.
    link = link_of(ALL)
    link[300:, LINK_SCHEMA.slices["achieved_ns"]] = -1
    cut = stalls_s(TICKS, a_task(1000), link, solves_of(answered[answered < 300]))
    assert cut["edge"] == pytest.approx(0.1, abs=0.01)


def test_a_message_behind_those_of_an_outage_does_not_make_the_shim_stand_still() -> None:
    # At the end of an outage, at 705 ms, the shim releases ten messages a millisecond.
    link = link_of(ALL)
    out = (ALL >= 300) & (ALL < 700)
    nominal_ms = np.where(out, 705 - ALL, 5)
    released_ms = np.maximum(ALL + nominal_ms, np.where(ALL >= 300, 705 + (ALL - 300) / 10, 0))
    link[:, LINK_SCHEMA.slices["nominal_ns"]] = (nominal_ms * MS)[:, None]
    link[:, LINK_SCHEMA.slices["achieved_ns"]] = ((released_ms - ALL) * MS)[:, None]
    assert stalls_s(TICKS, a_task(1000), link, None)["shim"] < 0.005
    # A message that was sent after the last of them has no excuse.
    link[980, LINK_SCHEMA.slices["achieved_ns"]] = 305 * MS
    assert stalls_s(TICKS, a_task(1000), link, None)["shim"] == pytest.approx(0.3)


def test_the_edge_of_lc_answers_seldom() -> None:
    stalled = Machine(2, stalls_s={"edge": 0.4})
    assert reasons(stalled, "lc") == []
    assert reasons(stalled) == ["the machine was too slow: no answer left the edge for 0.40 s"]
