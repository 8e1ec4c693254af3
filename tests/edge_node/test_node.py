from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from edge_node.node import EdgeNode
from shared.config.control_settings import CorrectionConfig
from shared.telemetry.schema import SOLVE_SCHEMA
from shared.wbc.contacts import ContactMode
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.qp import QpStatus
from shared.wbc.torque import recover_torque
from shared.wbc.whole_body import WholeBodyController
from shared.wire.codec import Codec
from tests.messages import altered, make_state


@pytest.fixture(scope="module")
def codec(robot, config, motion):
    return Codec(robot, config, motion)


@pytest.fixture
def edge(robot, config, motion):
    return EdgeNode(robot, config, motion)


@pytest.fixture
def state(robot, codec):
    def encode(sequence=0, **changes):
        return codec.encode_state(make_state(robot, sequence=sequence, **changes))

    return encode


def test_without_a_state_there_is_nothing_to_do(edge):
    assert edge.step() is None


def test_an_answer_echoes_session_sequence_and_stamp_of_its_state(edge, codec, state):
    edge.receive(state(17, session=99, stamp_ns=123_456_789_012), 0)
    answer = edge.step()
    assert answer.state_sequence == 17
    message = codec.decode_projector(answer.data)
    assert (message.session, message.sequence) == (99, 17)
    assert message.stamp_ns == 123_456_789_012


@pytest.mark.parametrize("mode", list(ContactMode))
def test_an_answer_holds_the_projector_of_the_mode_of_its_state(edge, codec, state, mode):
    edge.receive(state(mode=mode), 0)
    message = codec.decode_projector(edge.step().data)
    assert message.mode is mode
    assert [timed.projector.mode for timed in message.projectors] == [mode]


def test_an_answer_of_a_standing_robot_may_be_used_from_its_state_on(edge, codec, state):
    edge.receive(state(), 0)
    (timed,) = codec.decode_projector(edge.step().data).projectors
    assert timed.valid_from_ns == codec.decode_state(state()).time_ns
    assert timed.valid_until_ns > 10**15


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_torque_and_solution_are_those_of_the_projector_sent(
    robot, model, motion, configured, stacks, states, dtype
):
    config = configured(**{"wire.projector_dtype": dtype})
    codec, edge = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    stack = stacks[ContactMode.DOUBLE_SUPPORT]
    for k, (q, v) in enumerate(possible(states)[:10]):
        edge.receive(codec.encode_state(make_state(robot, sequence=k, q=q, v=v)), 0)
        answer = edge.step()
        assert answer is not None
        assert answer.data is not None
        message = codec.decode_projector(answer.data)
        b = stack.right_hand_side(model.kinematics(q, v), motion.reference(0))
        y = message.projectors[0].projector.apply(b)
        np.testing.assert_array_equal(message.y, y)
        np.testing.assert_array_equal(message.tau, recover_torque(model, stack.contacts, q, v, y))


def test_each_state_is_answered_once(edge, state):
    edge.receive(state(), 0)
    assert edge.step() is not None
    assert edge.step() is None


def test_only_the_newest_of_several_states_is_answered(edge, state):
    for sequence in (3, 5, 9):
        edge.receive(state(sequence), 0)
    assert edge.step().state_sequence == 9
    assert edge.step() is None
    assert not edge.refused


@pytest.mark.parametrize("late", [4, 5])
def test_a_state_that_is_not_newer_is_stale(edge, state, late):
    edge.receive(state(5), 0)
    edge.step()
    edge.receive(state(late), 0)
    assert edge.refused == {"stale": 1}
    assert edge.step() is None


def test_a_late_state_does_not_replace_a_newer_one_that_waits(edge, state):
    edge.receive(state(5), 0)
    edge.receive(state(4), 0)
    assert edge.step().state_sequence == 5


def test_a_robot_that_started_anew_is_served_from_its_first_state(edge, state):
    edge.receive(state(5000, session=1), 0)
    edge.step()
    edge.receive(state(0, session=2), 0)
    assert edge.step().state_sequence == 0
    assert not edge.refused


def test_a_solution_does_not_depend_on_the_states_before(robot, config, motion, state):
    fresh, used = EdgeNode(robot, config, motion), EdgeNode(robot, config, motion)
    v = np.full(37, 0.1)
    for sequence in range(5):
        used.receive(state(sequence, v=sequence * v, mode=ContactMode(sequence % 3)), 0)
        used.step()
    for edge in (fresh, used):
        edge.receive(state(9, v=-v), 0)
    assert fresh.step().data == used.step().data


@pytest.mark.parametrize("solver", ["daqp", "proxsuite"])
def test_a_solver_is_asked_where_the_last_active_set_is_not_the_optimal_one(
    robot, motion, configured, states, solver
):
    config = configured(**{"wbc.solver": solver})
    codec, used = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    asked = []
    for k, (q, v) in enumerate(possible(states)[:12]):
        for again in range(2):
            data = codec.encode_state(make_state(robot, sequence=2 * k + again, q=q, v=v))
            fresh = EdgeNode(robot, config, motion)
            for edge in (fresh, used):
                edge.receive(data, 0)
            answer, expected = used.step(), fresh.step()
            assert answer is not None
            assert expected is not None
            assert answer.data == expected.data
            assert expected.solution.iterations > 0
            asked.append(answer.solution.iterations > 0)
    # The same state again never takes one; the next, which is unlike it, does.
    assert not any(asked[1::2])
    assert all(asked[0::2])


def possible(states):
    """States within the limits of the robot: every fourth has limbs all over the place."""
    return [each for k, each in enumerate(states) if k % 4 < 3]


def damaged(data):
    """One message for each way of being wrong, by the reason it must be counted under."""

    def poison(fields):
        fields["v"] = np.full(37, np.nan).tobytes()

    return {
        "undecodable": data[:-1],
        "oversized": bytes(2000),
        "not_finite": altered(data, poison),
        "shape": altered(data, lambda f: f.update(q=f["q"][:-8])),
        "version": altered(data, lambda f: f.update(version=99)),
        "kind": altered(data, lambda f: f.update(kind="projector")),
        "config": altered(data, lambda f: f.update(config=b"otherwise")),
        "plan": altered(data, lambda f: f.update(plan=b"elsewhere")),
        "mode": altered(data, lambda f: f.update(mode=3)),
    }


def test_bad_messages_are_counted_by_reason_and_not_answered(edge, state):
    messages = damaged(state(7))
    for data in [*messages.values(), b"", b"hello"]:
        edge.receive(data, 0)
        assert edge.step() is None
    assert edge.refused == {**dict.fromkeys(messages, 1), "undecodable": 3}
    # A refused message is not remembered as seen.
    edge.receive(state(7), 0)
    assert edge.step().state_sequence == 7


def test_bad_messages_do_not_keep_a_good_one_from_being_answered(edge, state):
    edge.receive(state(7), 0)
    for data in damaged(state(8)).values():
        edge.receive(data, 0)
    assert edge.step().state_sequence == 7


@pytest.mark.parametrize(
    ("solver", "speed"),
    [("daqp", 1e5), ("daqp", 1e17), ("daqp", 1e160), ("proxsuite", 1e5), ("proxsuite", 1e160)],
)
def test_a_state_beyond_physics_is_solved_or_named_and_never_raises(
    robot, motion, configured, solver, speed
):
    config = configured(**{"wbc.solver": solver})
    codec, edge = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    data = codec.encode_state(make_state(robot, sequence=0, v=np.full(37, speed)))
    with np.errstate(all="ignore"):
        solution, _ = edge.solve(codec.decode_state(data))
    assert (solution.projector is None) == (solution.status is not QpStatus.SOLVED)
    # It is not answered, and the next good state is.
    edge.receive(data, 0)
    assert edge.refused == {"limits": 1}
    assert edge.step() is None
    edge.receive(codec.encode_state(make_state(robot, sequence=1)), 0)
    assert edge.step().solution.status is QpStatus.SOLVED


def moved(place, value, *, of="q"):
    """Changes of a state: one number of q or of v."""

    def change(robot):
        numbers = robot.q_standing.copy() if of == "q" else np.zeros(robot.model.nv)
        numbers[place] += value
        return {of: numbers}

    return change


IMPOSSIBLE = {
    "a joint, one turn away": moved(20, 50.0),
    "a joint, a little beyond its range": moved(10, 3.0),
    "a joint that is too fast": moved(20, 101.0, of="v"),
    "no rotation": moved(slice(3, 7), [0.0, 0.0, 0.0, -1.0]),
    "a rotation of another length": moved(slice(3, 7), [0.0, 0.0, 0.0, 1.0]),
    "a base in the air": moved(2, 2.0),
    "a base below the floor": moved(2, -2.0),
    "a base that is too fast": moved(0, 21.0, of="v"),
    "a base that spins": moved(4, -51.0, of="v"),
}


@pytest.mark.parametrize("change", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_a_state_in_which_the_robot_cannot_be_is_refused(edge, robot, state, change):
    edge.receive(state(**change(robot)), 0)
    assert edge.refused == {"limits": 1}
    assert edge.step() is None


def test_a_falling_robot_beyond_its_joint_range_is_still_served(edge, robot, state):
    q, v = robot.q_standing.copy(), np.full(robot.model.nv, 9.0)
    q[7:], q[2] = robot.model.upperPositionLimit[7:] + 1.4, 0.4
    edge.receive(state(q=q, v=v), 0)
    assert edge.step() is not None


# ---- sessions

MS = 1_000_000
HUGE = 2**63 - 1


@pytest.mark.parametrize(
    "hostile",
    [
        {"sequence": HUGE},
        {"sequence": 3_000},
        {"sequence": 1_000, "stamp_ns": HUGE},
        {"sequence": 1_000, "stamp_ns": 10**10},
        {"sequence": HUGE, "stamp_ns": HUGE, "held_sequences": (-1, -1, -1)},
    ],
    ids=str,
)
@pytest.mark.parametrize("hit_ms", [500, 50, 0])
def test_one_state_from_far_ahead_does_not_shut_out_the_honest_ones(edge, state, hostile, hit_ms):
    """Of an established session it costs nothing, in its first moments a tenth of a second."""
    answered = []
    for tick in range(1000):
        if tick == hit_ms:
            edge.receive(state(**{"stamp_ns": (tick + 7) * MS, **hostile}), tick * MS)
            edge.step()
        held = hostile.get("held_sequences")
        data = state(tick, stamp_ns=(tick + 7) * MS, held_sequences=held and (tick - 1,) * 3)
        edge.receive(data, tick * MS)
        answered.append(edge.sessions.waiting)
        # Solving takes time, and the question is who is heard.
        if edge.sessions.next() is None:
            continue
    silent = answered.count(False)
    assert silent == 0 if hit_ms == 500 else silent <= 100
    assert all(answered[hit_ms + 101 :])


def test_a_state_of_the_far_future_does_not_stop_the_answers_to_a_robot_that_corrects(edge, state):
    edge.receive(state(0, stamp_ns=0, held_sequences=NOTHING_HELD), 0)
    edge.step()
    for tick in range(1, 600):
        edge.receive(state(tick, stamp_ns=tick * MS, held_sequences=(0, 0, 0)), tick * MS)
        edge.step()
    signs = edge.solved["solved"]
    edge.receive(state(600, stamp_ns=HUGE, held_sequences=(0, 0, 0)), 600 * MS)
    assert edge.refused == {"ahead": 1}
    for tick in range(601, 1200):
        edge.receive(state(tick, stamp_ns=tick * MS, held_sequences=(0, 0, 0)), tick * MS)
        edge.step()
    # A sign of life every 0.1 s, as before.
    assert edge.solved["solved"] >= signs + 5


@pytest.mark.parametrize("jump_ms", [10, 900, 60_000])
def test_a_link_that_was_silent_is_no_jump(edge, state, jump_ms):
    for tick in range(300):
        edge.receive(state(tick, stamp_ns=tick * MS), tick * MS)
    # The first to arrive at the end of an outage is the oldest, the next the newest.
    now_ns = (300 + jump_ms) * MS
    edge.receive(state(300, stamp_ns=300 * MS), now_ns)
    edge.receive(state(300 + jump_ms, stamp_ns=now_ns), now_ns)
    assert not edge.refused
    assert edge.step().state_sequence == 300 + jump_ms


def test_a_session_begins_with_a_delay_that_shrinks(edge, state):
    edge.receive(state(0, stamp_ns=0), 5_000 * MS)
    edge.receive(state(5_000, stamp_ns=5_000 * MS), 5_000 * MS)
    assert edge.step().state_sequence == 5_000


def test_reordered_states_do_not_begin_a_session_anew(edge, state):
    for tick in range(500):
        edge.receive(state(tick ^ 1, stamp_ns=(tick ^ 1) * MS), tick * MS)
    assert edge.refused == {"stale": 250}
    assert not edge.sessions.renewed


def test_sessions_are_served_in_turn_however_often_one_of_them_sends(edge, state):
    served = []
    for tick in range(60):
        # The flooding one is always the last to arrive.
        edge.receive(state(tick, session=1), tick * MS)
        for k in range(20):
            edge.receive(state(20 * tick + k, session=2), tick * MS)
        _, _, newest = edge.sessions.next()
        served.append(newest.session)
    assert served.count(1) == served.count(2) == 30


def test_robots_of_different_names_are_served_in_turn_and_answered_by_name(edge, state):
    for robot in ("amy", "bob"):
        edge.receive(state(7, session=5), 0, robot=robot)
    answers = [edge.step(), edge.step()]
    assert sorted(answer.robot for answer in answers) == ["amy", "bob"]
    assert edge.step() is None


def test_what_one_session_holds_is_not_anothers(edge, codec, state):
    for session in (1, 2):
        edge.receive(state(0, session=session, held_sequences=NOTHING_HELD), 0)
        assert len(codec.decode_factorisations(edge.step().data).factorisations) == 3
    # Each is left alone when it has what it needs.
    for session in (1, 2):
        edge.receive(state(1, session=session, held_sequences=(0, 0, 0)), 0)
        assert edge.step() is None


def test_two_robots_of_one_name_are_both_served_and_noticed_once(edge, state):
    for tick in range(1500):
        for session in (1, 2) if tick < 1000 else (1,):
            edge.receive(state(tick, session=session), tick * MS, robot="amy")
    assert edge.sessions.shared == {"amy": 1}


def test_a_robot_that_has_started_anew_does_not_share_its_name(edge, state):
    for tick in range(1000):
        edge.receive(state(tick, session=1), tick * MS, robot="amy")
    for tick in range(1000):
        edge.receive(state(tick, session=2), (1000 + tick) * MS, robot="amy")
        if tick < 20:  # on their way when it ended
            edge.receive(state(1000 + tick, session=1), (1000 + tick) * MS, robot="amy")
    assert not edge.sessions.shared


def test_a_crowd_of_sessions_does_not_push_out_an_established_one(edge, state):
    for tick in range(500):
        edge.receive(state(tick, session=1), tick * MS)
        for k in range(10):
            edge.receive(state(0, session=100 + 10 * tick + k), tick * MS)
    assert len(edge.sessions._sessions) <= 8
    # It is remembered: a state of its past is stale. The others had to wait for room.
    edge.receive(state(0, session=1), 500 * MS)
    assert edge.refused["stale"] == 1
    assert edge.refused["crowded"] > 4000


def test_a_robot_that_comes_into_a_crowd_gets_its_place(edge, state, rng):
    for tick in range(500):
        messages = [state(0, session=100 + 10 * tick + k) for k in range(10)]
        if tick > 100:
            place = rng.integers(len(messages) + 1)
            messages.insert(place, state(tick, session=1, stamp_ns=tick * MS))
        for data in messages:
            edge.receive(data, tick * MS)
    edge.receive(state(0, session=1), 500 * MS)
    assert edge.refused["stale"] == 1


def test_solves_are_counted_by_their_outcome(edge, state):
    for sequence in range(3):
        edge.receive(state(sequence), 0)
        edge.step()
    assert edge.solved == {"solved": 3}


def test_a_row_tells_what_the_solve_did(edge, state):
    edge.receive(state(12), 0)
    answer = edge.step()
    row = np.zeros(SOLVE_SCHEMA.width)
    answer.record(row, wall_ns=77, solve_ns=300)
    named = {name: row[where][0] for name, where in SOLVE_SCHEMA.slices.items()}
    assert named == {
        "wall_ns": 77,
        "state_sequence": 12,
        "solve_ns": 300,
        "status": list(QpStatus).index(QpStatus.SOLVED),
        "iterations": answer.solution.iterations,
        "active_set": answer.solution.projector.active_set,
    }


def test_an_unsolved_state_leaves_a_row_without_an_active_set(edge, state):
    edge.receive(state(0), 0)
    solved = edge.step()
    failed = dataclasses.replace(
        solved,
        solution=dataclasses.replace(solved.solution, status=QpStatus.INFEASIBLE, projector=None),
        data=None,
    )
    row = np.zeros(SOLVE_SCHEMA.width)
    failed.record(row, wall_ns=1, solve_ns=1)
    assert row[SOLVE_SCHEMA.slices["status"]] == list(QpStatus).index(QpStatus.INFEASIBLE)
    assert row[SOLVE_SCHEMA.slices["active_set"]] == -1


NOTHING_HELD = (-1, -1, -1)


def test_a_robot_that_corrects_is_sent_factorisations_of_its_state(
    edge, codec, state, stacks, states, model
):
    q, v = states[1]
    at_rest = np.zeros_like(v)
    edge.receive(
        state(
            17, session=99, stamp_ns=123_456_789_012, q=q, v=at_rest, held_sequences=NOTHING_HELD
        ),
        0,
    )
    answer = edge.step()
    assert answer.state_sequence == 17
    message = codec.decode_factorisations(answer.data)
    assert (message.session, message.sequence, message.stamp_ns) == (99, 17, 123_456_789_012)
    assert [each.mode for each in message.factorisations] == list(ContactMode)
    for each in message.factorisations:
        matrices = stacks[each.mode].matrices(model.jacobians(q))
        expected = factorise_kkt(stacks[each.mode], matrices, q[7:])
        for name in ("P", "Q", "T", "A", "posture"):
            # Half a unit in the last of 24 bits.
            np.testing.assert_allclose(
                getattr(each, name), getattr(expected, name), rtol=2.0**-24, atol=1e-12
            )


def test_a_robot_in_motion_is_sent_a_factorisation_of_where_it_soon_is(edge, codec, state, states):
    q, v = states[1]
    edge.receive(state(0, q=q, v=v, held_sequences=NOTHING_HELD), 0)
    sent = codec.decode_factorisations(edge.step().data).factorisations[0].posture - q[7:]
    distance = CorrectionConfig().refresh_distance
    assert 0.0 < np.sqrt(np.mean(sent**2)) < distance
    np.testing.assert_allclose(
        sent / np.linalg.norm(sent), v[6:] / np.linalg.norm(v[6:]), atol=1e-5
    )


def test_a_robot_that_holds_what_it_needs_is_left_alone(edge, state):
    edge.receive(state(0, held_sequences=NOTHING_HELD), 0)
    assert edge.step() is not None
    for sequence in (1, 2, 3):
        edge.receive(state(sequence, held_sequences=(0, 0, 0)), 0)
        assert edge.step() is None
    assert edge.solved == {"solved": 1}
    assert not edge.refused


def test_now_and_then_it_is_told_that_the_edge_is_there(edge, codec, state):
    edge.receive(state(0, stamp_ns=10**9, held_sequences=NOTHING_HELD), 0)
    edge.step()
    edge.receive(state(100, stamp_ns=10**9 + 100_000_000, held_sequences=(0, 0, 0)), 0)
    message = codec.decode_factorisations(edge.step().data)
    assert message.sequence == 100
    assert message.factorisations == ()


def test_what_is_sent_later_has_the_modes_that_are_due_only(edge, codec, state, robot):
    edge.receive(state(0, held_sequences=NOTHING_HELD), 0)
    edge.step()
    q = robot.q_standing.copy()
    q[7:] += 1.1 * CorrectionConfig().refresh_distance
    edge.receive(state(1, stamp_ns=361_000_000, q=q, held_sequences=(0, 0, 0)), 0)
    message = codec.decode_factorisations(edge.step().data)
    assert [each.mode for each in message.factorisations] == [ContactMode.DOUBLE_SUPPORT]
    np.testing.assert_allclose(message.factorisations[0].posture, q[7:], atol=1e-7)


def test_damping_is_in_what_is_sent(robot, motion, configured, stacks, model, state):
    config = configured(**{"correction.damping": 0.05})
    codec, edge = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    edge.receive(state(0, held_sequences=NOTHING_HELD), 0)
    q = robot.q_standing
    answer = edge.step()
    assert answer is not None
    assert answer.data is not None
    for each in codec.decode_factorisations(answer.data).factorisations:
        matrices = stacks[each.mode].matrices(model.jacobians(q))
        damped = factorise_kkt(stacks[each.mode], matrices, q[7:], damping=0.05)
        undamped = factorise_kkt(stacks[each.mode], matrices, q[7:])
        np.testing.assert_allclose(each.P, damped.P, rtol=2.0**-24, atol=1e-12)
        assert np.abs(undamped.P - damped.P).max() > 0.1


def test_a_configuration_that_cannot_be_factorised_is_named_and_tried_again(
    edge, state, monkeypatch
):
    edge.receive(state(0, held_sequences=NOTHING_HELD), 0)
    with monkeypatch.context() as singular:
        singular.setattr(WholeBodyController, "factorise", lambda *_, **__: None)
        answer = edge.step()
    assert answer.data is None
    assert answer.solution.status is QpStatus.NOT_FINITE
    assert edge.solved == {"not_finite": 1}
    row = np.zeros(SOLVE_SCHEMA.width)
    answer.record(row, wall_ns=1, solve_ns=1)
    assert row[SOLVE_SCHEMA.slices["active_set"]] == -1
    # It is not remembered as sent.
    edge.receive(state(1, held_sequences=NOTHING_HELD), 0)
    assert edge.step().data is not None


def test_one_edge_serves_either_kind_of_robot(edge, codec, state):
    edge.receive(state(0, held_sequences=NOTHING_HELD), 0)
    codec.decode_factorisations(edge.step().data)
    edge.receive(state(1), 0)
    codec.decode_projector(edge.step().data)
    edge.receive(state(0, session=6, held_sequences=NOTHING_HELD), 0)
    codec.decode_factorisations(edge.step().data)
