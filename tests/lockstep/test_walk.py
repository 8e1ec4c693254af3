"""Romeo walks: over delays, with the contact switches prepared; and not without."""

from __future__ import annotations

import numpy as np
import pytest

from netem.profile import LOST
from shared.telemetry.schema import Source
from tests.lockstep.conftest import SHORT_STANDS

MS = 1_000_000


def walk(play, delay_ms, **changes):
    """Three steps of 0.1 m with the on-board computer as slow as the link, as in Table III."""
    return play(
        task="walk",
        **{
            "link.network": f"constant:{delay_ms}ms",
            "switch.compute_ns": delay_ms * MS,
            "switch.compute_time_scale": 1.0,
            "walk.double_support": 0.005,
            "walk.steps": 3,
            **SHORT_STANDS,
            **changes,
        },
    )


def test_without_delay_romeo_arrives_where_the_plan_ends(play):
    result = walk(play, 0)
    assert not result.summary["fell"]
    com = result.schema.column(result.rows, "com")[-1]
    reference = result.schema.column(result.rows, "com_reference")[-1]
    assert np.linalg.norm(com - reference) < 0.05
    # Two advancing steps of 0.1 m.
    assert com[0] > 0.17


@pytest.mark.parametrize("delay_ms", [25, 60])
def test_locally_assisted_walks_over_a_delay(play, delay_ms):
    result = walk(play, delay_ms)
    assert not result.summary["fell"]
    assert result.summary["com_error_m"] <= 0.022


def test_around_a_switch_the_robot_uses_its_own_solutions(play):
    # At 25 ms the on-board computer, as slow as the link, still has the newer state at times.
    result = walk(play, 25)
    assert result.summary["commands"]["on_board"] > 0
    # One preparation for each end of each single support, and full QPs in the windows.
    assert result.summary["on_board_qps"] > 6


def test_every_switch_is_prepared_even_with_a_computer_slower_than_a_double_support(play):
    summary = walk(play, 25).summary
    assert summary["commands"]["held"] == 0
    # A loaded foot stays where it was set down: 0.45 mm measured.
    assert summary["foot_slip_mm"]["max"] < 2.0
    # A double support of 5 ms is over before its own answer can be there.
    assert summary["switch_to_fresh_ms"]["never"] == 2
    assert summary["switch_to_fresh_ms"]["max"] <= 26.0


UNPREPARED = {"switch.prepare_on_board": False, "switch.prepare_on_edge": False}


def test_without_preparation_the_robot_holds_its_joints_after_every_switch(play):
    result = walk(play, 60, **UNPREPARED)
    in_task = result.schema.column(result.rows, "time_ns") >= 0
    mode, source = (
        result.schema.column(result.rows, name)[in_task].astype(int) for name in ("mode", "source")
    )
    switches = np.flatnonzero(np.diff(mode)) + 1
    assert len(switches) > 0
    for switch in switches:
        # The first answer to a state of the new mode is a round trip away. Whether the robot falls
        # meanwhile is chance.
        assert np.all(source[switch : switch + 60] == Source.HELD)
    assert np.all(source[: switches[0]] == Source.CACHED)
    assert walk(play, 60).summary["commands"]["held"] == 0


def test_either_end_alone_can_prepare_a_switch(play):
    for missing in UNPREPARED:
        summary = walk(play, 3, **{missing: False, "walk.steps": 2}).summary
        assert not summary["fell"]
        assert summary["commands"]["held"] <= 5 * 2


def test_the_active_set_used_is_the_true_one_without_delay_and_older_with_it(play):
    assert walk(play, 0).summary["active_set_discrepancy"]["max"] == 0
    later = [walk(play, delay).summary["active_set_discrepancy"]["mean"] for delay in (25, 60)]
    assert 0 < later[0] < later[1]


def test_states_the_edge_never_saw_have_a_true_active_set_too(play, trace):
    delays = np.full((2, 1000), 1.0)
    delays[0, 300:500] = LOST
    settings = {"push": [], "duration": 0.6, "link.network": trace(delays)}
    known = []
    for all_active_sets in (False, True):
        summary = play(**settings, all_active_sets=all_active_sets).summary
        assert summary["link"]["uplink"]["received"] < 600
        known.append(sum(summary["active_set_discrepancy"]["ticks"]))
    assert known[0] <= 400 < known[1] == 600


def test_purely_remote_walks_over_small_delays_with_a_larger_violation(play):
    summary = walk(play, 5, controller="pr", **{"walk.steps": 2}).summary
    assert not summary["fell"]
    assisted = walk(play, 5, **{"walk.steps": 2}).summary
    assert summary["contact_violation_m_s2"] > 10 * assisted["contact_violation_m_s2"]


@pytest.mark.parametrize(
    "plan",
    [
        {"step_length": 0.15},
        {"step_length": -0.1, "com_plan": "mpc"},
        {"step_length": 0.05, "step_sideways": 0.03, "step_turn": 0.22},
    ],
    ids=str,
)
def test_romeo_walks_every_way_over_a_delay(play, plan):
    result = walk(play, 25, **{f"walk.{name}": value for name, value in plan.items()})
    assert not result.summary["fell"]
    com = result.schema.column(result.rows, "com")[-1]
    reference = result.schema.column(result.rows, "com_reference")[-1]
    assert np.linalg.norm(com - reference) < 0.01
    assert result.summary["com_error_m"] < 0.015
