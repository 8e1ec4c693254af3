"""Steps by touch: out of standing after a push, and a walk by plans of the edge."""

from __future__ import annotations

import math

import numpy as np
import pytest

from experiments.lockstep import Lockstep
from shared.config.config_file import load_config
from shared.robots import Foot
from shared.telemetry.schema import STEP_SCHEMA, FootprintKind
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from tests.lockstep.test_pushes import ITS_LIMITS

STEPS = {
    "controller": "lc",
    "link.network": "constant:10ms",
    **ITS_LIMITS,
    "wbc.weights.swing_foot": 3.0,
    "stepping.mode": "on",
    "correction.on_board_budget": 0.0,
}
WALK = {
    **STEPS,
    "task": "walk",
    "push": [],
    "wire.projector_dtype": "float32",
    "sensors.joint_position_noise": 1e-3,
    "walk.step_duration": 0.5,
    "walk.steps": 3,
    "walk.begin_duration": 0.6,
}


def play(**settings):
    lockstep = Lockstep(load_config(None, {"view": "off", **settings}), all_active_sets=False)
    return lockstep, lockstep.run()


def switches(result):
    mode = result.schema.column(result.rows, "mode")
    return int(np.count_nonzero(np.diff(mode)))


def footprints(result, kind):
    """The rows of footprints of a kind."""
    return result.step_rows[STEP_SCHEMA.column(result.step_rows, "kind") == kind]


def test_without_a_push_the_robot_does_not_step():
    lockstep, result = play(**STEPS, push=[], duration=0.5)
    assert lockstep.robot.clock.phase == 0
    assert lockstep.robot.plans.law != 0
    assert switches(result) == 0


@pytest.mark.parametrize("cut", [False, True])
def test_after_a_hard_push_the_robot_steps_and_stands(cut):
    """150 N forward for 0.2 s, half as much again as it stands without a step; with the link cut
    at the push, the on-board computer factorises.
    """
    settings = {"link.outage": ["cut@200ms"], "correction.on_board_budget": 0.3} if cut else {}
    lockstep, result = play(push=["150N@0.2s:0.2s:+x"], duration=1.6, **{**STEPS, **settings})
    assert not result.summary["fell"]
    assert switches(result) >= 2
    assert lockstep.robot.clock.mode is ContactMode.DOUBLE_SUPPORT
    assert not lockstep.robot.refused
    ahead = lockstep.robot.clock.feet.values()
    assert max(foot.x for foot in ahead) > 0.1
    chosen, landed = (
        footprints(result, each) for each in (FootprintKind.CHOSEN, FootprintKind.LANDED)
    )
    assert set(STEP_SCHEMA.column(chosen, "plan")) == {-1}
    # The feet of the beginning, then the step; the foot lands where and when the law said last.
    assert STEP_SCHEMA.column(landed, "time_ns")[:2].tolist() == [-1, -1]
    of_step = chosen[
        STEP_SCHEMA.column(chosen, "time_ns") < STEP_SCHEMA.column(landed, "time_ns")[2]
    ]
    for name, within in (("foot", 0), ("position", 0.03), ("landing_ns", 50e6)):
        last, at = (STEP_SCHEMA.column(rows, name) for rows in (of_step[-1:], landed[2:3]))
        np.testing.assert_allclose(last, at, rtol=0.0, atol=within)


def test_a_walk_goes_by_plans_and_touch():
    lockstep, result = play(**WALK, duration=2.8)
    clock = lockstep.robot.clock
    assert not result.summary["fell"]
    assert clock.phase == 6
    assert lockstep.robot.plans.plan >= 5
    left, right = clock.feet.values()
    # Two steps of 0.1 m and one that brings the feet together.
    assert left.x == pytest.approx(right.x, abs=0.06)
    assert (left.x + right.x) / 2 == pytest.approx(0.21, abs=0.06)
    planned, landed = (
        footprints(result, each) for each in (FootprintKind.PLANNED, FootprintKind.LANDED)
    )
    assert STEP_SCHEMA.column(landed, "foot").tolist() == [0, 1, 0, 1, 0]
    # Every foot lands near its footprint in the plan that the robot had then.
    where = STEP_SCHEMA.slices
    for step in landed[2:]:
        (goal,) = (
            row
            for row in planned
            if all(row[where[name]] == step[where[name]] for name in ("plan", "place"))
        )
        np.testing.assert_allclose(step[where["position"]], goal[where["position"]], atol=0.04)


def test_a_walk_goes_over_blocks_that_no_plan_knows():
    """Heights within ± 2 cm. A foot lands early on a high block, and late on a low one."""
    settings = {"wbc.weights.com": 100.0, "wbc.weights.swing_foot": 10.0, "walk.com_lowering": 0.03}
    ground = {"plant.unknown_ground": "blocks:2cm", "seed": 4, "walk.steps": 5}
    lockstep, result = play(**{**WALK, **settings, **ground}, duration=3.6)
    assert not result.summary["fell"]
    assert lockstep.robot.clock.phase >= 8
    # The toes of both are on blocks.
    assert min(foot.x for foot in lockstep.robot.clock.feet.values()) > 0.1
    assert max(abs(foot.z) for foot in lockstep.robot.clock.feet.values()) > 5e-3


def test_no_foot_of_la_lifts_into_a_dead_link():
    """The first step would begin 0.33 s after the newest answer, which expires after 0.5 s."""
    settings = {"controller": "la", "link.outage": ["cut@300ms"]}
    lockstep, result = play(**{**WALK, **settings}, duration=0.9)
    assert lockstep.robot.plans.plan >= 0
    assert lockstep.robot.clock.phase == 0
    assert not result.summary["fell"]
    without, _ = play(**{**WALK, **settings, "stepping.lift_within": np.inf}, duration=0.9)
    assert without.robot.clock.phase > 0


def test_feet_that_land_by_touch_turn_onto_a_slope(robot):
    settings = {"wbc.weights.com": 100.0, "wbc.weights.swing_foot": 10.0, "walk.com_lowering": 0.03}
    way = {"task": "go", "ground": "slope:8deg", "walk.goal": "0.42,0", "walk.end_duration": 0.8}
    _, result = play(**{**WALK, **settings, **way}, duration=3.5)
    assert not result.summary["fell"]
    q = result.schema.column(result.rows, "q")[-1]
    soles = WholeBodyModel(robot).sole_placements(q)
    for foot in Foot:
        assert soles[foot].translation[0] > 0.3
        assert math.degrees(math.asin(soles[foot].rotation[2, 0])) == pytest.approx(8.0, abs=1.5)


def test_a_walk_whose_link_dies_ends_in_a_stand():
    lockstep, result = play(**WALK, duration=2.8, **{"link.outage": ["cut@900ms"]})
    assert not result.summary["fell"]
    assert lockstep.robot.clock.phase == 6
    assert lockstep.robot.clock.mode is ContactMode.DOUBLE_SUPPORT
