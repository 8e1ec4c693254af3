from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from edge_node.node import EdgeNode
from shared.config.settings import CorrectionConfig
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
    edge.receive(state(17, session=99, stamp_ns=123_456_789_012))
    answer = edge.step()
    assert answer.state_sequence == 17
    message = codec.decode_projector(answer.data)
    assert (message.session, message.sequence) == (99, 17)
    assert message.stamp_ns == 123_456_789_012


@pytest.mark.parametrize("mode", list(ContactMode))
def test_an_answer_holds_the_projector_of_the_mode_of_its_state(edge, codec, state, mode):
    edge.receive(state(mode=mode))
    message = codec.decode_projector(edge.step().data)
    assert message.mode is mode
    assert [timed.projector.mode for timed in message.projectors] == [mode]


def test_an_answer_of_a_standing_robot_may_be_used_from_its_state_on(edge, codec, state):
    edge.receive(state())
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
    for k, (q, v) in enumerate(states[:10]):
        edge.receive(codec.encode_state(make_state(robot, sequence=k, q=q, v=v)))
        answer = edge.step()
        assert answer is not None
        assert answer.data is not None
        message = codec.decode_projector(answer.data)
        b = stack.right_hand_side(model.kinematics(q, v), motion.reference(0))
        y = message.projectors[0].projector.apply(b)
        np.testing.assert_array_equal(message.y, y)
        np.testing.assert_array_equal(message.tau, recover_torque(model, stack.contacts, q, v, y))


def test_each_state_is_answered_once(edge, state):
    edge.receive(state())
    assert edge.step() is not None
    assert edge.step() is None


def test_only_the_newest_of_several_states_is_answered(edge, state):
    for sequence in (3, 5, 9):
        edge.receive(state(sequence))
    assert edge.step().state_sequence == 9
    assert edge.step() is None
    assert not edge.refused


@pytest.mark.parametrize("late", [4, 5])
def test_a_state_that_is_not_newer_is_stale(edge, state, late):
    edge.receive(state(5))
    edge.step()
    edge.receive(state(late))
    assert edge.refused == {"stale": 1}
    assert edge.step() is None


def test_a_late_state_does_not_replace_a_newer_one_that_waits(edge, state):
    edge.receive(state(5))
    edge.receive(state(4))
    assert edge.step().state_sequence == 5


def test_a_robot_that_started_anew_is_served_from_its_first_state(edge, state):
    edge.receive(state(5000, session=1))
    edge.step()
    edge.receive(state(0, session=2))
    assert edge.step().state_sequence == 0
    assert not edge.refused


def test_a_solution_does_not_depend_on_the_states_before(robot, config, motion, state):
    fresh, used = EdgeNode(robot, config, motion), EdgeNode(robot, config, motion)
    v = np.full(37, 0.1)
    for sequence in range(5):
        used.receive(state(sequence, v=sequence * v, mode=ContactMode(sequence % 3)))
        used.step()
    for edge in (fresh, used):
        edge.receive(state(9, v=-v))
    assert fresh.step().data == used.step().data


@pytest.mark.parametrize("solver", ["daqp", "proxsuite"])
def test_a_solver_is_asked_where_the_last_active_set_is_not_the_optimal_one(
    robot, motion, configured, states, solver
):
    config = configured(**{"wbc.solver": solver})
    codec, used = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    asked = []
    for k, (q, v) in enumerate(states[:12]):
        for again in range(2):
            data = codec.encode_state(make_state(robot, sequence=2 * k + again, q=q, v=v))
            fresh = EdgeNode(robot, config, motion)
            for edge in (fresh, used):
                edge.receive(data)
            answer, expected = used.step(), fresh.step()
            assert answer is not None
            assert expected is not None
            assert answer.data == expected.data
            assert expected.solution.iterations > 0
            asked.append(answer.solution.iterations > 0)
    # The same state again never takes one; the next, which is unlike it, does.
    assert not any(asked[1::2])
    assert all(asked[0::2])


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
        edge.receive(data)
        assert edge.step() is None
    assert edge.refused == {**dict.fromkeys(messages, 1), "undecodable": 3}
    # A refused message is not remembered as seen.
    edge.receive(state(7))
    assert edge.step().state_sequence == 7


def test_bad_messages_do_not_keep_a_good_one_from_being_answered(edge, state):
    edge.receive(state(7))
    for data in damaged(state(8)).values():
        edge.receive(data)
    assert edge.step().state_sequence == 7


@pytest.mark.parametrize(
    ("solver", "speed"),
    [("daqp", 1e5), ("daqp", 1e17), ("daqp", 1e160), ("proxsuite", 1e5), ("proxsuite", 1e160)],
)
def test_a_state_beyond_physics_is_answered_or_named_and_never_raises(
    robot, motion, configured, solver, speed
):
    config = configured(**{"wbc.solver": solver})
    codec, edge = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    edge.receive(codec.encode_state(make_state(robot, sequence=0, v=np.full(37, speed))))
    with np.errstate(all="ignore"):
        answer = edge.step()
    assert (answer.data is None) == (answer.solution.status is not QpStatus.SOLVED)
    assert edge.solved == {answer.solution.status.value: 1}
    # And the next good state is served.
    edge.receive(codec.encode_state(make_state(robot, sequence=1)))
    assert edge.step().solution.status is QpStatus.SOLVED


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (1e5, 0, 0, 1e5), (2, 0, 0, 0)], ids=str)
def test_an_orientation_that_is_no_rotation_does_not_raise(edge, robot, state, quaternion):
    q = robot.q_standing.copy()
    q[3:7] = quaternion
    edge.receive(state(q=q))
    with np.errstate(all="ignore"):
        assert edge.step() is not None


def test_solves_are_counted_by_their_outcome(edge, state):
    for sequence in range(3):
        edge.receive(state(sequence))
        edge.step()
    assert edge.solved == {"solved": 3}


def test_a_row_tells_what_the_solve_did(edge, state):
    edge.receive(state(12))
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
    edge.receive(state(0))
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
        state(17, session=99, stamp_ns=123_456_789_012, q=q, v=at_rest, held_sequences=NOTHING_HELD)
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
    edge.receive(state(0, q=q, v=v, held_sequences=NOTHING_HELD))
    sent = codec.decode_factorisations(edge.step().data).factorisations[0].posture - q[7:]
    distance = CorrectionConfig().refresh_distance
    assert 0.0 < np.sqrt(np.mean(sent**2)) < distance
    np.testing.assert_allclose(
        sent / np.linalg.norm(sent), v[6:] / np.linalg.norm(v[6:]), atol=1e-5
    )


def test_a_robot_that_holds_what_it_needs_is_left_alone(edge, state):
    edge.receive(state(0, held_sequences=NOTHING_HELD))
    assert edge.step() is not None
    for sequence in (1, 2, 3):
        edge.receive(state(sequence, held_sequences=(0, 0, 0)))
        assert edge.step() is None
    assert edge.solved == {"solved": 1}
    assert not edge.refused


def test_now_and_then_it_is_told_that_the_edge_is_there(edge, codec, state):
    edge.receive(state(0, stamp_ns=10**9, held_sequences=NOTHING_HELD))
    edge.step()
    edge.receive(state(100, stamp_ns=10**9 + 100_000_000, held_sequences=(0, 0, 0)))
    message = codec.decode_factorisations(edge.step().data)
    assert message.sequence == 100
    assert message.factorisations == ()


def test_what_is_sent_later_has_the_modes_that_are_due_only(edge, codec, state, robot):
    edge.receive(state(0, held_sequences=NOTHING_HELD))
    edge.step()
    q = robot.q_standing.copy()
    q[7:] += 1.1 * CorrectionConfig().refresh_distance
    edge.receive(state(1, stamp_ns=361_000_000, q=q, held_sequences=(0, 0, 0)))
    message = codec.decode_factorisations(edge.step().data)
    assert [each.mode for each in message.factorisations] == [ContactMode.DOUBLE_SUPPORT]
    np.testing.assert_allclose(message.factorisations[0].posture, q[7:], atol=1e-7)


def test_damping_is_in_what_is_sent(robot, motion, configured, stacks, model, state):
    config = configured(**{"correction.damping": 0.05})
    codec, edge = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    edge.receive(state(0, held_sequences=NOTHING_HELD))
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
    edge.receive(state(0, held_sequences=NOTHING_HELD))
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
    edge.receive(state(1, held_sequences=NOTHING_HELD))
    assert edge.step().data is not None


def test_one_edge_serves_either_kind_of_robot(edge, codec, state):
    edge.receive(state(0, held_sequences=NOTHING_HELD))
    codec.decode_factorisations(edge.step().data)
    edge.receive(state(1))
    codec.decode_projector(edge.step().data)
    edge.receive(state(0, session=6, held_sequences=NOTHING_HELD))
    codec.decode_factorisations(edge.step().data)
