"""Steps by touch: out of standing after a push, and a walk by plans of the edge."""

from __future__ import annotations

import math

import numpy as np
import pytest

from experiments.lockstep import Lockstep
from robot_node.cache import ProjectorCache
from shared.config.config_file import load_config
from shared.robots import Foot
from shared.telemetry.schema import STEP_SCHEMA, FootprintKind, Source
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
    lockstep, result = play(**{**WALK, **settings}, duration=0.85)
    assert lockstep.robot.plans.plan >= 0
    assert lockstep.robot.clock.phase == 0
    assert not result.summary["fell"]
    without, _ = play(**{**WALK, **settings, "stepping.lift_within": np.inf}, duration=0.85)
    assert without.robot.clock.phase > 0


@pytest.mark.parametrize("in_the_air", [True, False])
def test_the_projector_of_the_coming_mode_is_as_old_as_the_newest_answer(in_the_air, monkeypatch):
    """Over 50 ms no answer to a state on both feet comes within the 30 ms between two steps. If the
    edge prepares in the air only the landing, the newest answer says nothing about the next step:
    its projector is that of the step before, and expires as the foot lifts.
    """
    settings = {**WALK, "controller": "la", "link.network": "constant:50ms", "duration": 1.2}
    config = load_config(None, {"view": "off", **settings})
    lockstep = Lockstep(config, all_active_sets=False)
    node, edge, cache = lockstep.robot, lockstep.edge, lockstep.robot.cache
    assert isinstance(cache, ProjectorCache)
    prepare, advance, ages = edge._prepared_for_steps, node.clock.reference, []

    def only_the_landing(session, state, stepper, *, room):
        if state.mode is not ContactMode.DOUBLE_SUPPORT:
            session.prepared = ContactMode(3 - state.mode)
        return prepare(session, state, stepper, room=room)

    def advanced(measured, *, time_ns, decides):
        before = node.clock.phase
        reference = advance(measured, time_ns=time_ns, decides=decides)
        if node.clock.phase > before and reference.mode is not ContactMode.DOUBLE_SUPPORT:
            coming = cache.lookup(reference.mode, time_ns=time_ns)
            assert coming is not None
            stamps = cache.newest_stamp_ns, coming.stamp_ns
            ages.append([lockstep.clock.now_ns() - stamp_ns for stamp_ns in stamps])
        return reference

    if not in_the_air:
        monkeypatch.setattr(edge, "_prepared_for_steps", only_the_landing)
    monkeypatch.setattr(node.clock, "reference", advanced)
    result = lockstep.run()
    first, second = np.array(ages) / 1e6
    assert max(first[0], second[0]) <= 52.0
    assert first[1] <= first[0] + 2.0
    held = np.count_nonzero(result.schema.column(result.rows, "source")[100:] == Source.HELD)
    if in_the_air:
        assert second[1] <= second[0] + 2.0
        assert held == 0
    else:
        assert second[1] > 450.0
        assert held > 0


def test_no_foot_lifts_while_the_joints_are_held():
    """The plan's time passes in an outage. When the link is back the robot stands, with its CoM
    between the feet, and has to shift its weight before the first step.
    """
    settings = {"controller": "la", "link.outage": ["1s@300ms"]}
    lockstep, result = play(**{**WALK, **settings}, duration=2.5)
    assert not result.summary["fell"]
    time_ns, mode, source = (
        result.schema.column(result.rows, name) for name in ("time_ns", "mode", "source")
    )
    held = (source == Source.HELD) & (time_ns > 0)
    assert held.sum() > 400
    released_ns, lifted_ns = time_ns[held][-1], time_ns[mode != 0][0]
    assert lifted_ns - released_ns > 0.5e9
    # Without the shift the first step goes 17 cm to the side.
    assert sum(foot.y for foot in lockstep.robot.clock.feet.values()) / 2 == pytest.approx(
        0.0, abs=0.03
    )


def test_after_an_outage_la_goes_on_to_its_goal(robot):
    """The joints are held in a step. The goal stays where it is in the world."""
    settings = {"controller": "la", "link.outage": ["800ms@1s"]}
    way = {"task": "go", "walk.goal": "0.3,0", "walk.end_duration": 0.8}
    lockstep, result = play(**{**WALK, **settings, **way}, duration=4.2)
    assert not result.summary["fell"]
    source = result.schema.column(result.rows, "source")
    assert np.count_nonzero(source[100:] == Source.HELD) > 200
    soles = WholeBodyModel(robot).sole_placements(result.schema.column(result.rows, "q")[-1])
    for foot, own in lockstep.robot.clock.feet.items():
        place = soles[foot].translation
        assert place[0] == pytest.approx(0.3, abs=0.06)
        np.testing.assert_allclose(place[:2], own.position, rtol=0.0, atol=0.01)


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
