"""The locally corrected robot over a link with a round trip of a second, and over none at all."""

from __future__ import annotations

import numpy as np
import pytest

from netem.profile import LOST
from tests.lockstep.conftest import SHORT_STANDS

ROUND_TRIP = {"link.network": "constant:1s"}
# The push is from 1.0 s to 1.2 s.
SECONDS = 3.0


def column(result, name):
    return result.schema.column(result.rows, name)


def in_task(result):
    return column(result, "time_ns") >= 0


@pytest.fixture(scope="module")
def pushed(play):
    """100 N for 0.2 s."""
    return play(duration=SECONDS, controller="lc", **ROUND_TRIP)


@pytest.fixture(scope="module")
def walked(play):
    return play(task="walk", controller="lc", **ROUND_TRIP, **SHORT_STANDS, **{"walk.steps": 3})


def test_at_a_second_it_balances_a_push_as_locally_assisted_does_without_delay(play, pushed):
    assisted = play(duration=SECONDS, controller="la", **{"link.network": "constant:0ms"}).summary
    assert not pushed.summary["fell"]
    assert pushed.summary["task_seconds"] == SECONDS
    # 1.56 cm both, measured over 5 s.
    assert pushed.summary["com_error_m"] <= 1.05 * assisted["com_error_m"]


def test_every_command_is_a_correction_of_an_answer_a_second_old(pushed):
    assert pushed.summary["commands"] == {
        "fresh": 0,
        "cached": 0,
        "held": 0,
        "on_board": 0,
        "corrected": 1000 * SECONDS,
        "stopping": 0,
    }
    assert column(pushed, "projector_age_ns")[in_task(pushed)].min() > 1e9


def test_its_corrections_converge_all_the_time(pushed, walked):
    for result in (pushed, walked):
        contraction = column(result, "contraction")[in_task(result)]
        known = contraction[np.isfinite(contraction)]
        assert len(known) > 0.99 * len(contraction)
        # 0.46 measured, in single support.
        assert known.max() < 0.7
        assert np.nanmax(column(result, "staleness_rad")) > 0.1


def test_answers_are_sent_when_they_are_needed_only(pushed):
    # Locally assisted, one a millisecond: 28 MB/s.
    downlink = pushed.summary["link"]["downlink"]
    assert downlink["sent"] < 120
    assert downlink["bytes_per_message"]["max"] <= 40_000


def test_at_a_second_it_walks_without_a_computer_of_its_own(walked):
    summary = walked.summary
    assert not summary["fell"]
    assert summary["task_seconds"] == pytest.approx(3.8)
    assert summary["on_board_qps"] == 0
    assert (column(walked, "source")[in_task(walked)] == 4).all()
    com, reference = column(walked, "com")[-1], column(walked, "com_reference")[-1]
    # Two advancing steps of 0.1 m, 0.6 mm from where the plan ends.
    assert com[0] > 0.18
    assert np.linalg.norm(com - reference) < 0.01
    # 10.0 mm and 0.6 mm measured; locally assisted without delay, 9.8 mm.
    assert summary["com_error_m"] < 0.015
    assert summary["foot_slip_mm"]["max"] < 2.0


def test_a_contact_switch_finds_its_factorisation_there(walked):
    task = in_task(walked)
    modes = column(walked, "mode")[task].astype(int)
    switches = np.flatnonzero(np.diff(modes)) + 1
    assert len(switches) == 6
    assert set(modes) == {0, 1, 2}
    # The forces in the first tick of a mode are those of its feet.
    forces = column(walked, "f")[task].reshape(-1, 2, 12)
    for tick in switches:
        loaded = {0: [True, True], 1: [True, False], 2: [False, True]}[modes[tick]]
        assert forces[tick].any(axis=1).tolist() == loaded


def test_a_link_that_is_cut_for_good_is_withstood(play, trace):
    delays = np.full((2, 4000), 5.0)
    delays[:, 300:] = LOST
    result = play(
        duration=1.8,
        controller="lc",
        push=["100N@0.4s:0.2s:+y"],
        **{"link.network": trace(delays), "loop.hold_after": 0.1},
    )
    assert not result.summary["fell"]
    assert result.summary["commands"]["held"] == 0
    assert column(result, "projector_age_ns")[-1] > 1.4e9


ROUGH = {
    "duration": 0.6,
    "controller": "lc",
    "push": ["100N@0.1s:0.2s:+y"],
    "link.network": "factory/003",
    "link.loss": 0.2,
}


def test_the_same_seed_gives_the_same_run(play):
    first, second = play(**ROUGH), play(again=True, **ROUGH)
    assert first is not second
    assert first.summary["log_hash"] == second.summary["log_hash"]
    np.testing.assert_array_equal(first.link_rows, second.link_rows)


def test_another_seed_or_level_gives_another_run(play):
    runs = [play(**ROUGH), play(**ROUGH, seed=1), play(**ROUGH, **{"correction.level": "c"})]
    assert len({run.summary["log_hash"] for run in runs}) == 3


def test_a_trial_does_not_depend_on_the_one_before(play):
    play(**ROUGH, **{"correction.level": "b_adjoint"})
    first = play(**ROUGH).summary["log_hash"]
    assert play(again=True, **ROUGH).summary["log_hash"] == first


STALE = {
    "task": "walk",
    "controller": "lc",
    "link.network": "constant:0ms",
    "correction.refresh_distance": float("inf"),
}


def test_a_robot_that_doubts_its_corrections_finishes_the_step_and_stands(play):
    # Over any estimate at all: the walk ends as soon as it has begun.
    result = play(**STALE, **SHORT_STANDS, duration=3.6, **{"correction.stop_above": 0.0})
    assert not result.summary["fell"]
    assert result.summary["commands"]["stopping"] > 3200
    schema, rows = result.schema, result.rows
    assert schema.column(rows, "mode")[-1] == 0
    assert np.abs(schema.column(rows, "v")[-1]).max() < 0.05
    # One step forward, one that brings the feet together; the plan goes on to 0.5 m.
    assert 0.05 < schema.column(rows, "com")[-1, 0] < 0.2


def test_where_corrections_diverge_the_stale_optimum_is_used_without_a_jump(play, robot):
    settings = {"walk.steps": 1, **SHORT_STANDS, "correction.give_up_above": 0.25}
    result = play(**STALE, duration=1.6, **settings)
    assert not result.summary["fell"]
    commands = result.summary["commands"]
    assert commands["cached"] > 0
    assert commands["corrected"] > 0
    schema, rows = result.schema, result.rows
    source, tau = schema.column(rows, "source"), schema.column(rows, "tau")
    changed = np.flatnonzero((source[1:] == 1) != (source[:-1] == 1)) + 1
    # From the corrected to the uncorrected rung and back, after the task has begun.
    changed = changed[changed > 10]
    assert len(changed) > 0
    step = 0.1 * 1.45 * robot.effort_limit
    assert np.all(np.abs(tau[changed] - tau[changed - 1]) <= step + 1e-9)


def test_the_robots_own_computer_factorises_when_asked_for_help(play):
    result = play(
        **STALE,
        duration=1.5,
        **{"walk.steps": 1, "correction.refresh_above": 0.0, "correction.on_board_budget": 0.1},
    )
    assert not result.summary["fell"]
    # 2.4 ms each in a tenth of the time.
    assert 40 < result.summary["on_board_qps"] <= 1.5 / 0.024 + 1
    assert result.summary["commands"]["on_board"] > 1000
