"""The robot's tick by hand: measure, receive what the test says, command, record, advance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from edge_node.node import EdgeNode
from robot_node.node import RobotNode
from robot_node.safety import JointHold, TorqueGuard
from robot_node.tick import Tick
from shared.motion.plan_frame import PlanFrame
from shared.telemetry.schema import Source
from shared.wbc.answer import TimedProjector
from shared.wire.codec import Codec
from tests.messages import altered, make_state
from tests.robot_node.bench import DEADLINE_NS, MS, SESSION, Bench, nothing


@pytest.fixture
def bench(robot, motion, configured):
    def build(**overrides):
        return Bench(robot, motion, configured(**{"push": [], **overrides}))

    return build


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_the_answer_to_this_tick_is_fresh(bench, controller):
    played = bench(controller=controller).run(5)
    assert [command.source for command in played.commands] == [Source.FRESH] * 5
    assert [command.age_ns for command in played.commands] == [DEADLINE_NS] * 5


@pytest.mark.parametrize("controller", ["la", "pr", "lc"])
def test_what_a_tick_has_given_is_not_changed_by_later_ticks(bench, controller):
    # Much of what a tick computes with lies in Pinocchio's and MuJoCo's memory.
    played = bench(controller=controller).run(3)
    command, decision = played.commands[-1], played.commands[-1].decision
    true_state, measured = played.robot._true_state, (played.robot._q, played.robot._v)
    given = [command.tau, decision.tau, decision.y, *true_state, *measured, played.rows[-1]]
    before = [array.copy() for array in given]
    played.run(5, deliver=nothing)
    for array, copy in zip(given, before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_an_older_answer_is_cached_and_ages(bench):
    played = bench().run(1).run(3, deliver=nothing)
    assert [command.source for command in played.commands[1:]] == [Source.CACHED] * 3
    assert [command.age_ns for command in played.commands] == [
        DEADLINE_NS + k * MS for k in range(4)
    ]


def test_before_the_first_answer_the_robot_stands_still_and_its_task_does_not_begin(bench, robot):
    played = bench().run(4, deliver=nothing)
    assert not played.robot.running
    assert [command.source for command in played.commands] == [Source.HELD] * 4
    assert played.column("time_ns").tolist() == [-1] * 4
    for q in played.column("q"):
        np.testing.assert_allclose(q, robot.q_standing, atol=1e-15)
    played.run(2)
    assert played.robot.running
    assert played.column("time_ns").tolist() == [-1] * 4 + [0, MS]


def test_every_tick_sends_the_next_sequence_number_and_its_time(bench):
    played = bench()
    sent = []
    for _ in range(3):
        sent.append(played.codec.decode_state(played.robot.measure(played.now_ns)))
        played.tick()
    assert [state.sequence for state in sent] == [0, 1, 2]
    assert [state.stamp_ns for state in sent] == [0, MS, 2 * MS]
    assert [state.time_ns for state in sent] == [0, MS, 2 * MS]
    assert {state.session for state in sent} == {SESSION}


def test_noise_after_the_start_does_not_depend_on_how_long_the_robot_waited(bench):
    def noise(waiting):
        played = bench().run(waiting, deliver=nothing).run(1)
        result = []
        for _ in range(3):
            true = played.robot._plant.state()[0]
            measured = played.codec.decode_state(played.robot.measure(played.now_ns)).q
            result.append(measured - true)
            command = played.robot.command(played.now_ns + DEADLINE_NS)
            played.robot.advance(command)
        return np.array(result)

    # The same random numbers on states that differ a little: rounding of their sums.
    np.testing.assert_allclose(noise(0), noise(25), atol=1e-15)


def test_both_controllers_give_the_same_torque_for_a_fresh_answer(bench):
    assisted, remote = bench(controller="la").run(30), bench(controller="pr").run(30)
    for left, right in zip(assisted.commands, remote.commands, strict=True):
        np.testing.assert_array_equal(left.tau, right.tau)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_that_holds_for_every_number_format_of_the_wire(bench, dtype):
    changes = {"wire.projector_dtype": dtype}
    assisted = bench(controller="la", **changes).run(10)
    remote = bench(controller="pr", **changes).run(10)
    for left, right in zip(assisted.commands, remote.commands, strict=True):
        np.testing.assert_array_equal(left.tau, right.tau)


def test_a_stale_projector_still_feeds_this_tick_back(bench):
    # Sensor noise changes every tick: an assisted robot reacts to it, a remote one cannot.
    assisted = bench(controller="la").run(1).run(2, deliver=nothing).commands
    remote = bench(controller="pr").run(1).run(2, deliver=nothing).commands
    assert np.abs(assisted[2].tau - assisted[1].tau).max() > 0.01
    np.testing.assert_array_equal(remote[2].tau, remote[1].tau)


def test_beyond_its_age_limit_the_cache_is_not_used_and_the_joints_are_held(bench):
    # At tick k the answer of tick 0 is k + 0.5 ms old: the limit of 2.5 ms is met and not exceeded.
    played = bench(**{"loop.hold_after": 2.5e-3}).run(1).run(4, deliver=nothing)
    sources = [command.source.name for command in played.commands]
    assert sources == ["FRESH", "CACHED", "CACHED", "HELD", "HELD"]
    assert played.commands[3].decision is None
    assert played.commands[3].age_ns == 3 * MS + DEADLINE_NS


def test_the_joints_are_held_from_where_they_were_controlled_before(bench, robot):
    played, expected = bench(**{"loop.hold_after": 1e-3}), JointHold(robot, timestep=1e-3)
    guard = TorqueGuard(robot, clamp=1.45)
    for _ in range(30):
        played.tick()
        expected.observe(played.codec.decode_state(played.sent).q)
    for _ in range(4):  # 1.5 ms old: held from here on
        command = played.tick(deliver=nothing)
        state = played.codec.decode_state(played.sent)
        tau = guard.accept(expected.torque(state.q, state.v))
        np.testing.assert_array_equal(command.tau, tau)


def test_an_answer_ends_the_hold(bench):
    played = bench(**{"loop.hold_after": 2.5e-3}).run(1).run(5, deliver=nothing).run(1)
    assert played.commands[-1].source is Source.FRESH


def test_a_robot_that_was_carried_away_in_a_hold_stands_on_where_it_is(bench):
    """Its torques are those of a twin that stayed: the plan has gone along."""
    carried_by = PlanFrame(0.5, -0.2, 0.7)
    changes = {"loop.hold_after": 2.5e-3, "sensors.joint_position_noise": 0.0}
    stayed, carried = (bench(**changes).run(20).run(20, deliver=nothing) for _ in range(2))
    for each, by in ((stayed, PlanFrame()), (carried, carried_by)):
        plant, before = each.robot._plant, PlanFrame()
        # In small steps: a base that jumps is a fault of its estimate.
        for part in np.linspace(0.01, 1.0, 100):
            q, v = plant.state()
            after = PlanFrame(part * by.x, part * by.y, part * by.yaw)
            plant.set_state(after.in_world(before.in_plan(q)), v)
            each.run(1, deliver=nothing)
            before = after
    # Long enough for 30 ms at the old place to be forgotten, with a time constant of 50 ms.
    for each in (stayed, carried):
        each.run(1000, deliver=nothing).run(5)
        assert [command.source for command in each.commands[-5:]] == [Source.FRESH] * 5
    for left, right in zip(stayed.commands[-5:], carried.commands[-5:], strict=True):
        np.testing.assert_allclose(left.tau, right.tau, rtol=0.0, atol=1e-3)
    x, y, yaw = carried.column("plan_in_world")[-1]
    np.testing.assert_allclose([x, y, yaw], [0.5, -0.2, 0.7], atol=1e-3)
    # The reference is told in the world, where the robot is.
    errors = stayed.column("com_error_m")[-1], carried.column("com_error_m")[-1]
    assert errors[1] == pytest.approx(errors[0], abs=1e-4)
    # The state is sent in the plan's frame: the edge needs no field for it.
    np.testing.assert_allclose(carried.state.q[:2], stayed.state.q[:2], atol=1e-3)


def test_a_hold_of_a_few_ticks_leaves_the_plan_where_it_is(bench):
    played = bench(**{"loop.hold_after": 2.5e-3}).run(1).run(60, deliver=nothing).run(5)
    assert not played.column("plan_in_world").any()
    np.testing.assert_array_equal(played.column("plan_time_ns"), played.column("time_ns"))


def test_time_goes_on_while_the_joints_are_held(bench):
    played = bench(**{"loop.hold_after": 1e-3}).run(1).run(4, deliver=nothing)
    assert played.column("time_ns").tolist() == [0, MS, 2 * MS, 3 * MS, 4 * MS]


def garbage(answer):
    """One message for each way of being wrong, by the reason it must be counted under."""

    def poison(fields):
        fields["tau"] = np.full(31, np.nan).tobytes()

    return {
        "undecodable": answer[:-7],
        "oversized": bytes(50_000),
        "not_finite": altered(answer, poison),
        "layout": altered(answer, lambda f: f["projectors"][0].update(layout=bytes(8))),
        "shape": altered(answer, lambda f: f.update(y=f["y"][:-8])),
        "version": altered(answer, lambda f: f.update(version=99)),
        "kind": altered(answer, lambda f: f.update(kind="state")),
        "config": altered(answer, lambda f: f.update(config=bytes(8))),
        "plan": altered(answer, lambda f: f.update(plan=bytes(8))),
        "mode": altered(answer, lambda f: f.update(mode=9)),
        "dtype": altered(answer, lambda f: f["projectors"][0].update(dtype="int8")),
        "session": altered(answer, lambda f: f.update(session=SESSION + 1)),
        "future": altered(answer, lambda f: f.update(sequence=f["sequence"] + 1000)),
    }


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_bad_messages_are_counted_by_reason_and_change_nothing(bench, controller):
    reasons = set()

    def with_garbage(answer):
        reasons.update(garbage(answer))
        bad = list(garbage(answer).values())
        # Before and after the good one, so that neither order lets one in.
        return [*bad, answer, *bad]

    clean = bench(controller=controller).run(20)
    attacked = bench(controller=controller).run(20, deliver=with_garbage)
    np.testing.assert_array_equal(attacked.column("tau"), clean.column("tau"))
    np.testing.assert_array_equal(attacked.column("q"), clean.column("q"))
    np.testing.assert_array_equal(attacked.column("source"), clean.column("source"))
    expected = dict.fromkeys(reasons, 2 * 20)
    assert attacked.robot.cache.refused == expected
    assert attacked.column("refused")[-1] == sum(expected.values())


def test_garbage_alone_never_starts_the_robot(bench):
    played = bench().run(5, deliver=lambda answer: list(garbage(answer).values()))
    assert not played.robot.running
    assert {command.source for command in played.commands} == {Source.HELD}


def test_a_repeated_answer_changes_nothing_and_is_stale_from_the_next_tick_on(bench):
    clean = bench().run(10)
    past: list[bytes] = []

    def repeat(answer):
        messages = [*past[-1:], answer, answer]
        past.append(answer)
        return messages

    repeated = bench().run(10, deliver=repeat)
    np.testing.assert_array_equal(repeated.column("tau"), clean.column("tau"))
    assert repeated.robot.cache.refused == {"stale": 9}


@pytest.mark.parametrize("controller", ["la", "pr"])
@pytest.mark.parametrize("scale", [1e6, 1e100, 1e160, 1e250, 1e300])
def test_a_well_formed_answer_of_absurd_numbers_never_passes_the_clamp(bench, controller, scale):
    played = bench(controller=controller)

    def absurd(message):
        (timed,) = message.projectors
        projector = dataclasses.replace(timed.projector, A_dagger=scale * timed.projector.A_dagger)
        return dataclasses.replace(
            message,
            tau=scale * message.tau,
            y=scale * message.y,
            projectors=(TimedProjector(projector, timed.valid_from_ns, timed.valid_until_ns),),
        )

    played.run(1)
    # That numbers overflow on the way is the point; NumPy need not say so.
    with np.errstate(all="ignore"):
        command = played.tick(deliver=played.doctored(absurd))
    assert np.isfinite(command.tau).all()
    assert np.all(np.abs(command.tau) <= played.robot._guard.limit)


def test_a_projector_outside_its_time_is_not_used(bench):
    played = bench()

    def expiring(message):
        timed = dataclasses.replace(message.projectors[0], valid_until_ns=2 * MS)
        return dataclasses.replace(message, projectors=(timed,))

    played.run(1, deliver=played.doctored(expiring)).run(4, deliver=nothing)
    sources = [command.source.name for command in played.commands]
    assert sources == ["FRESH", "CACHED", "HELD", "HELD", "HELD"]


def test_a_push_acts_from_its_start_for_its_duration(bench):
    played = bench(push=["30N@0.003s:0.004s:-x", "20N@0.005s:0.004s:+z"]).run(12)
    push = played.column("push_n")
    assert push[:, 0].tolist() == [0] * 3 + [-30] * 4 + [0] * 5
    assert push[:, 1].tolist() == [0] * 12
    assert push[:, 2].tolist() == [0] * 5 + [20] * 4 + [0] * 3


def test_a_push_moves_the_robot_its_way(bench):
    calm, pushed = bench().run(30), bench(push=["100N@0.001s:1.0s:+y"]).run(30)
    assert pushed.column("com")[-1, 1] > calm.column("com")[-1, 1] + 1e-4


def test_a_row_tells_what_the_tick_did(bench, robot, model):
    played = bench().run(3)
    row, command = played.rows[-1], played.commands[-1]
    schema = played.robot.schema

    def column(name):
        return schema.column(row[None], name)[0]

    assert column("tick") == 2
    assert column("time_ns") == 2 * MS
    assert column("wall_ns") == 2 * MS
    assert column("source") == Source.FRESH
    assert column("mode") == 0
    assert column("projector_age_ns") == DEADLINE_NS
    np.testing.assert_array_equal(column("tau"), command.tau)
    np.testing.assert_array_equal(column("f"), command.decision.y[37:])
    np.testing.assert_allclose(column("com"), model.com_and_soles(column("q"))[0], atol=1e-14)
    difference = column("com") - column("com_reference")
    assert column("com_error_m") == pytest.approx(np.linalg.norm(difference), rel=1e-12)
    # A fresh solution keeps the rigid contact: what is left is rounding of accelerations near 10.
    assert column("contact_violation_m_s2") < 1e-9
    assert column("projector_sequence") == 2
    projector = played.robot.cache.lookup(command.decision.mode, time_ns=2 * MS).projector
    assert column("active_set") == sum(1 << row for row in projector.active)
    # An assisted robot corrects nothing.
    assert np.isnan(column("contraction"))
    assert np.isnan(column("staleness_rad"))
    np.testing.assert_allclose(column("foot_slip_m"), 0.0, atol=1e-4)
    assert column("on_board_qps") == 0


def test_a_held_tick_has_no_forces_and_no_violation_to_report(bench):
    played = bench().run(1, deliver=nothing)
    np.testing.assert_array_equal(played.column("f")[0], 0.0)
    assert np.isnan(played.column("contact_violation_m_s2")[0])
    assert played.column("projector_age_ns")[0] == -1


def test_a_stale_projector_shows_as_a_violated_contact(bench):
    played = bench(push=["100N@0.001s:1.0s:+y"]).run(1).run(60, deliver=nothing)
    assert played.column("contact_violation_m_s2")[-1] > 1e-3


def test_a_fall_is_noticed(bench, robot):
    played = bench().run(2)
    assert not played.robot.fallen
    q = robot.q_standing.copy()
    q[2] -= 0.4
    played.robot._plant.set_state(q, np.zeros(37))
    played.run(1)
    assert played.robot.fallen


def test_a_fall_is_noticed_where_no_rows_are_kept(robot, motion, configured):
    node = RobotNode(robot, configured(push=[]), motion)
    tick = Tick(node)
    q = robot.q_standing.copy()
    q[2] -= 0.4
    node._plant.set_state(q, np.zeros(37))
    tick.begin(0)
    tick.end(DEADLINE_NS, [])
    assert node.fallen


def test_a_state_that_is_not_finite_is_a_fall_and_no_exception(bench, robot):
    played = bench().run(2)
    played.robot._plant.data.qpos[20] = np.nan
    # The edge refuses such a state, so nothing arrives.
    played.robot.measure(played.now_ns)
    command = played.robot.command(played.now_ns + DEADLINE_NS)
    assert np.isfinite(command.tau).all()
    played.robot.advance(command)
    assert played.robot.fallen


def test_a_new_robot_has_a_session_of_its_own(robot, motion, configured):
    config = configured(push=[])
    codec = Codec(robot, config, motion)
    sessions = {
        codec.decode_state(RobotNode(robot, config, motion).measure(0)).session for _ in range(3)
    }
    assert len(sessions) == 3


def test_an_edge_of_other_settings_is_named_in_the_counters(bench, robot, motion, configured):
    played = bench()
    other = EdgeNode(robot, configured(push=[], **{"wbc.friction": 0.4}), motion)
    state = dataclasses.replace(make_state(robot), session=SESSION, sequence=0)
    other.receive(
        Codec(robot, configured(push=[], **{"wbc.friction": 0.4}), motion).encode_state(state), 0
    )
    answer = other.step().data
    played.run(1, deliver=lambda _: [answer])
    assert played.robot.cache.refused == {"config": 1}
