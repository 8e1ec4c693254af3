"""Robots whose base's estimate jumps and stays there, drifts, or is wrong from some time on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.faults.lockstep import disturb_sensors
from experiments.lockstep import Lockstep
from shared.config.config_file import load_config
from shared.motion.plan_frame import PlanFrame
from tests.lockstep.conftest import SHORT_STANDS

Wrong = Callable[[np.ndarray, np.ndarray, float], None]


def trial(wrong: Wrong, *, at, duration, **settings):
    """Play a trial in which `wrong` changes (q, v) in place, given the seconds since `at`."""
    settings = {"push": [], "link.network": "constant:10ms", "duration": duration, **settings}
    played = Lockstep(load_config(None, settings), all_active_sets=False)

    def from_then_on(q, v, time_ns):
        seconds = time_ns * 1e-9 - at
        if seconds >= 0.0:
            wrong(q, v, seconds)

    disturb_sensors(played, from_then_on)
    return played.run()


def moved(x=0.0, y=0.0, z=0.0, yaw=0.0) -> Wrong:
    """Return an estimate whose frame is elsewhere."""

    def wrong(q, v, seconds):
        q[:] = PlanFrame(x, y, yaw, z).in_world(q)

    return wrong


def tilted(roll, pitch) -> Wrong:
    def wrong(q, v, seconds):
        turn = pin.Quaternion(pin.exp3(np.array((roll, pitch, 0.0))))
        q[3:7] = (turn * pin.Quaternion(q[3:7])).coeffs()

    return wrong


def worst_error(result, *, after):
    """The largest CoM error [m] after a time of the task [s], from the true state."""
    schema, rows = result.schema, result.rows
    late = schema.column(rows, "time_ns").ravel() > after * 1e9
    return np.nanmax(schema.column(rows, "com_error_m").ravel()[late])


# Without the guard the first two felled Romeo 0.9 s and 1.5 s after the jump.
@pytest.mark.parametrize(
    ("controller", "jump"),
    [("lc", moved(x=1.0)), ("la", moved(x=0.2)), ("lc", moved(0.0, -5.0, 0.2, 2.0))],
)
def test_a_standing_robot_whose_estimate_jumps_stands_on_where_it_is(controller, jump):
    result = trial(jump, at=0.3, duration=1.8, controller=controller)
    assert not result.summary["fell"]
    assert result.summary["commands"]["held"] == 0
    assert worst_error(result, after=0.3) < 0.01
    assert result.summary["base_estimate"] == {"jumps": 1, "drifts": 0}


def test_a_robot_whose_estimate_jumps_walks_on():
    jump = moved(x=-0.3, y=1.0, yaw=0.5)
    settings = {"controller": "lc", "task": "walk", **SHORT_STANDS}
    result = trial(jump, at=0.9, duration=2.0, **settings)
    assert not result.summary["fell"]
    # As without the jump, in each direction.
    assert worst_error(result, after=0.9) < 0.04
    assert result.summary["base_estimate"]["jumps"] == 1


def test_a_robot_whose_estimate_drifts_stands_where_its_feet_are():
    """Without the anchor Romeo fell at 4.6 s with LA."""

    def drift(q, v, seconds):
        q[0] += 0.05 * seconds

    result = trial(drift, at=0.5, duration=5.0, controller="lc")
    assert not result.summary["fell"]
    assert result.summary["base_estimate"]["drifts"] >= 3


# These are no jumps of a frame, and no rule mends them. Romeo stands them off centre.
@pytest.mark.parametrize("degrees", [(3.0, 0.0), (0.0, 3.0), (0.0, -3.0)])
def test_a_tilt_that_is_wrong_by_three_degrees_is_stood(degrees):
    result = trial(tilted(*np.deg2rad(degrees)), at=0.3, duration=3.0, controller="lc")
    assert not result.summary["fell"]
    assert 0.01 < worst_error(result, after=2.0) < 0.06


def test_a_velocity_that_is_wrong_by_a_tenth_of_a_metre_a_second_is_stood():
    def biased(q, v, seconds):
        v[0] += 0.1

    result = trial(biased, at=0.3, duration=3.0, controller="lc")
    assert not result.summary["fell"]
    assert 0.01 < worst_error(result, after=2.0) < 0.06
