"""Romeo walks: over delays, with the contact switches prepared; and not without."""

from __future__ import annotations

import numpy as np
import pytest

MS = 1_000_000


def walk(play, delay_ms, **changes):
    """Six steps of 0.1 m with the on-board computer as slow as the link, as in Table III."""
    return play(
        task="walk",
        **{
            "link.network": f"constant:{delay_ms}ms",
            "switch.compute_ns": delay_ms * MS,
            "switch.compute_time_scale": 1.0,
            "walk.double_support": 0.005,
            "duration": 7.8,
            **changes,
        },
    )


def test_without_delay_romeo_arrives_where_the_plan_ends(play):
    result = walk(play, 0)
    assert not result.summary["fell"]
    com = result.schema.column(result.rows, "com")[-1]
    reference = result.schema.column(result.rows, "com_reference")[-1]
    assert np.linalg.norm(com - reference) < 0.05
    # Five advancing steps of 0.1 m.
    assert com[0] > 0.45


@pytest.mark.parametrize("delay_ms", [3, 25, 60])
def test_locally_assisted_walks_over_a_delay(play, delay_ms):
    result = walk(play, delay_ms)
    assert not result.summary["fell"]
    assert result.summary["com_error_m"] <= 0.022


def test_around_a_switch_the_robot_uses_its_own_solutions(play):
    # At 25 ms the on-board computer, as slow as the link, still has the newer state at times.
    assert walk(play, 25).summary["commands"]["on_board"] > 0


def test_preparing_a_switch_shortens_the_time_without_a_projector(play):
    unprepared = {"switch.prepare_on_board": False, "switch.prepare_on_edge": False}
    held = [walk(play, 60, **change).summary["commands"]["held"] for change in ({}, unprepared)]
    assert held[0] < 0.7 * held[1]
