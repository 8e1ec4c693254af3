"""The locally corrected robot by hand: its first answer, then nothing any more."""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest

from robot_node.controllers import ControllerParts
from robot_node.corrected import Contraction, LocallyCorrected
from robot_node.sensor_guard import HELD_OVER_TICKS
from shared.errors import MessageRefused
from shared.robots import Foot
from shared.robots.description import sole_frame_name
from shared.telemetry.schema import Source
from shared.wbc.contacts import FORCES_PER_FOOT, ContactMode
from shared.wbc.correction import Corrector, Iterate
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.projector import full_problem
from shared.wbc.qp import make_solver
from shared.wire.codec import Codec
from tests.messages import altered
from tests.robot_node.bench import DEADLINE_NS, MS, SESSION, Bench, nothing

DOUBLE = ContactMode.DOUBLE_SUPPORT
NOISELESS = {"sensors.joint_position_noise": 0.0}
# An answer to every state.
EVERY_STATE = {
    "correction.refresh_distance": 0.0,
    "correction.refresh_interval_ns": 0,
    "correction.average_ns": 0,
}
# The edge sends factorisations in single precision: 1.5e-7 of y measured. In wild poses it is 7e-4.
SINGLE_PRECISION = 1e-5


@pytest.fixture
def bench(robot, motion, configured):
    def build(**overrides):
        settings = {"controller": "lc", "push": [], **overrides}
        return Bench(robot, motion, configured(**settings))

    return build


@pytest.fixture
def optimum(model, stacks, reference):
    """y of the full QP at a state, optionally with the matrices of another posture."""
    stack, solver = stacks[DOUBLE], make_solver("daqp")

    def solve(state, *, posture=None):
        b = stack.right_hand_side(model.kinematics(state.q, state.v), reference)
        q = state.q.copy()
        if posture is not None:
            q[7:] = posture
        matrices = stack.matrices(model.jacobians(q))
        return solver.solve(full_problem(stack, matrices, b)).x

    return solve


def sources(played):
    return [command.source for command in played.commands]


def error(y, expected):
    return np.abs(y - expected).max() / np.abs(expected).max()


# ---- where a command comes from


def test_without_an_answer_the_joints_are_held(bench):
    played = bench().run(5, deliver=nothing)
    assert sources(played) == [Source.HELD] * 5
    assert not played.robot.running
    assert all(command.decision is None for command in played.commands)
    assert played.column("projector_age_ns").tolist() == [-1] * 5
    assert np.isnan(played.column("contraction")).all()
    assert np.isnan(played.column("staleness_rad")).all()


def test_from_the_first_answer_on_commands_are_corrected(bench):
    played = bench().run(1).run(9, deliver=nothing)
    assert sources(played) == [Source.FRESH] + [Source.CORRECTED] * 9
    # All of them rest on the first tick's state.
    assert [command.decision.sequence for command in played.commands] == [0] * 10
    ages = [DEADLINE_NS + k * MS for k in range(10)]
    assert [command.age_ns for command in played.commands] == ages
    assert played.column("projector_sequence").tolist() == [0] * 10


def test_one_answer_is_all_that_a_standing_robot_is_sent(bench):
    answers = []

    def deliver(answer):
        answers.append(answer)
        return [answer]

    bench().run(50, deliver=deliver)
    assert len(answers) == 1


def test_a_lost_answer_is_sent_again(bench):
    played = bench(**{"correction.retry_ns": 3 * MS})
    played.run(1, deliver=nothing).run(4)
    names = [source.name for source in sources(played)]
    assert names == ["HELD", "HELD", "HELD", "FRESH", "CORRECTED"]


def test_states_tell_what_the_robot_holds(bench):
    played = bench().run(1)
    assert played.state.held_sequences == (-1, -1, -1)
    played.run(1)
    assert played.state.held_sequences == (0, 0, 0)


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_robots_that_want_projectors_say_nothing_of_it(robot, motion, configured, controller):
    played = Bench(robot, motion, configured(controller=controller, push=[])).run(2)
    assert played.state.held_sequences is None


def test_an_answer_never_gets_too_old(bench):
    played = bench(**{"loop.hold_after": 2.5e-3}).run(1).run(20, deliver=nothing)
    assert sources(played) == [Source.FRESH] + [Source.CORRECTED] * 20


def test_when_its_link_is_cut_after_the_first_answer_the_robot_balances(bench):
    played = bench(**{"correction.refresh_distance": math.inf}).run(1).run(1000, deliver=nothing)
    assert sources(played)[1:] == [Source.CORRECTED] * 1000
    assert not played.robot.fallen
    # As with an answer to every state: 0.5 mm measured.
    assert played.column("com_error_m").max() < 2e-3
    assert played.column("time_ns")[-1] == 1000 * MS


def test_a_push_after_the_link_is_cut_is_withstood(bench):
    never = {"correction.refresh_distance": math.inf}
    played = bench(push=["100N@0.1s:0.2s:+y"], **never)
    played.run(1).run(1500, deliver=nothing)
    assert not played.robot.fallen
    assert set(sources(played)[1:]) == {Source.CORRECTED}
    # A joint has moved by 0.38 rad from where its only factorisation was computed, the CoM by 6 cm;
    # a second later it is on its way back.
    com_error = played.column("com_error_m")
    assert np.nanmax(played.column("staleness_rad")) > 0.3
    assert 0.02 < com_error.max() < 0.1
    assert com_error[-1] < 0.5 * com_error.max()


# ---- what a command is


def test_with_an_answer_to_every_state_a_command_is_the_optimum_there(bench, optimum):
    played = bench(**EVERY_STATE)
    for _ in range(30):
        y = played.tick().decision.y
        assert error(y, optimum(played.state)) < SINGLE_PRECISION
    assert sources(played) == [Source.FRESH] * 30


def test_a_command_has_the_torque_that_the_dynamics_demand(bench, robot, stacks):
    played = bench().run(1).run(40, deliver=nothing)
    command, (q, v) = played.commands[-1], (played.state.q, played.state.v)
    decision, model, data = command.decision, robot.model, robot.model.createData()
    a, f = np.split(decision.y, [model.nv])
    demanded = pin.crba(model, data, q) @ a + pin.nonLinearEffects(model, data, q, v)
    pin.computeJointJacobians(model, data, q)
    for k, foot in enumerate(Foot):
        frame = model.getFrameId(sole_frame_name(foot))
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        wrench_map = stacks[DOUBLE].contacts.wrench_map[foot]
        demanded = demanded - J.T @ wrench_map @ f[k * FORCES_PER_FOOT : (k + 1) * FORCES_PER_FOOT]
    scale = np.abs(demanded).max()
    np.testing.assert_allclose(decision.tau, demanded[6:], atol=1e-10 * scale)
    np.testing.assert_array_equal(command.tau, decision.tau)


def test_corrections_keep_the_dynamics_and_the_contacts_of_the_present_state(
    bench, model, stacks, reference
):
    played = bench(**NOISELESS, **{"correction.refresh_distance": math.inf})
    played.run(1).run(300, deliver=nothing)
    stack = stacks[DOUBLE]
    y, q, v = played.commands[-1].decision.y, played.state.q, played.state.v
    b = stack.right_hand_side(model.kinematics(q, v), reference)
    problem = full_problem(stack, stack.matrices(model.jacobians(q)), b)
    # What the state changes in a tick is what is left: 400 N of weight hang on these rows.
    assert np.abs(problem.E @ y - problem.e).max() < 1e-2


def test_a_stale_factorisation_still_feeds_this_tick_back(bench, optimum):
    # Sensor noise changes every tick: the robot reacts to it, as the optimum does.
    played = bench().run(1)
    for _ in range(30):
        y = played.tick(deliver=nothing).decision.y
        # 4 % measured at 1e-2 rad of noise: what level b leaves.
        assert error(y, optimum(played.state)) < 0.08
    moved = played.commands[-1].decision.y - played.commands[-2].decision.y
    assert np.abs(moved).max() > 1.0


def test_without_iterations_it_is_the_stale_optimum_of_this_tick(bench, optimum):
    played = bench(**{"correction.iterations": 0}).run(1)
    posture = played.state.q[7:]
    for _ in range(20):
        y = played.tick(deliver=nothing).decision.y
        assert error(y, optimum(played.state, posture=posture)) < SINGLE_PRECISION


def test_staleness_is_the_largest_distance_of_a_joint(bench):
    played = bench().run(1)
    posture = played.state.q[7:].astype(np.float32).astype(float)
    for _ in range(20):
        command = played.tick(deliver=nothing)
        expected = np.abs(played.state.q[7:] - posture).max()
        assert command.decision.staleness == pytest.approx(expected, rel=1e-12)
    assert played.column("staleness_rad")[-1] == command.decision.staleness
    # Of the answer to its own state: rounding.
    assert played.column("staleness_rad")[0] < 1e-6


def test_a_row_tells_what_the_tick_did(bench):
    played = bench().run(1).run(30, deliver=nothing)
    command = played.commands[-1]
    decision = command.decision
    assert played.column("source")[-1] == Source.CORRECTED
    assert played.column("active_set")[-1] == decision.active_set
    assert played.column("contraction")[-1] == decision.contraction
    assert played.column("projector_age_ns")[-1] == 30 * MS + DEADLINE_NS
    np.testing.assert_array_equal(played.column("f")[-1], decision.y[37:])
    np.testing.assert_array_equal(played.column("tau")[-1], command.tau)
    assert played.column("on_board_qps")[-1] == 0
    assert decision.mode is DOUBLE


# ---- a contact switch


class ByHand:
    """A controller with a factorisation of every mode, some 0.05 rad away from a state."""

    def __init__(self, parts, states):
        self.model, self.stacks = model, stacks = parts.model, parts.stacks
        self.q, self.v = states[1]
        jacobians = model.jacobians(states[5].q)
        made = tuple(
            factorise_kkt(stack, stack.matrices(jacobians), states[5].q[7:])
            for stack in stacks.values()
        )
        self.controller = LocallyCorrected(parts)
        self.controller.cache.keep(made, sequence=0, stamp_ns=0)
        self.correctors = {
            each.mode: Corrector(stacks[each.mode], each, level="b") for each in made
        }

    def command(self, reference):
        self.controller.observe(self.q, self.v, reference)
        return self.controller.command(time_ns=0)

    def stepped(self, iterate, reference, *, steps):
        """The iterate after some steps at the same state."""
        stack = self.stacks[reference.mode]
        for _ in range(steps):
            a, f = np.split(iterate.y, [self.model.nv])
            now = self.model.kinematics(self.q, self.v, a, stack.contacts.wrenches(f))
            residual = stack.right_hand_side(now, reference)
            step = self.correctors[reference.mode].step(iterate, residual, self.model, now)
            assert step is not None
            iterate = step[0]
        return iterate


@pytest.fixture
def by_hand(robot, motion, configured, model, stacks, states):
    def build(**settings):
        config = configured(**{f"correction.{name}": value for name, value in settings.items()})
        parts = ControllerParts(
            config=config,
            motion=motion,
            codec=Codec(robot, config, motion),
            session=SESSION,
            model=model,
            stacks=stacks,
            start_computer=lambda make_solve: pytest.fail("no budget for an on-board computer"),
        )
        return ByHand(parts, states)

    return build


@pytest.mark.parametrize("iterations", [1, 2])
@pytest.mark.parametrize("at_switch", [0, 1, 4])
def test_in_the_first_tick_of_a_mode_corrections_go_on_from_what_they_have_come_to(
    by_hand, stacks, reference, model, iterations, at_switch
):
    bench = by_hand(iterations=iterations, iterations_at_switch=at_switch)
    on_left = dataclasses.replace(reference, mode=ContactMode.LEFT_SUPPORT)
    expected = Iterate.zero(stacks[DOUBLE])
    for _ in range(3):
        expected = bench.stepped(expected, reference, steps=iterations)
        y = bench.command(reference).y
        np.testing.assert_allclose(y, expected.y, rtol=1e-9, atol=1e-9)
    expected = expected.in_mode(stacks[ContactMode.LEFT_SUPPORT], model.nv)
    for tick in range(3):
        steps = max(iterations, at_switch) if tick == 0 else iterations
        expected = bench.stepped(expected, on_left, steps=steps)
        decision = bench.command(on_left)
        assert decision.mode is ContactMode.LEFT_SUPPORT
        np.testing.assert_allclose(decision.y, expected.y, rtol=1e-9, atol=1e-9)


def test_more_iterations_come_nearer_to_where_corrections_lead(by_hand, stacks, reference):
    last = by_hand().stepped(Iterate.zero(stacks[DOUBLE]), reference, steps=30).y
    errors = [
        error(by_hand(iterations=iterations).command(reference).y, last)
        for iterations in (1, 2, 4, 8)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.1 * errors[0]


# ---- the contraction


def test_the_contraction_is_unknown_at_first():
    assert math.isnan(Contraction().estimate)


def test_the_contraction_is_the_ratio_of_two_successive_corrections():
    contraction = Contraction()
    contraction.observe(4.0, 1.0)
    assert contraction.estimate == 0.25
    # A constant ratio stays what it is, whatever the sizes are.
    for size in (1e-6, 3.0, 1e5):
        contraction.observe(size, 0.25 * size)
        assert contraction.estimate == pytest.approx(0.25, rel=1e-12)


def test_the_contraction_is_an_average_that_forgets():
    contraction = Contraction()
    contraction.observe(1.0, 0.1)
    contraction.observe(1.0, 0.9)
    assert 0.1 < contraction.estimate < 0.9
    for _ in range(100):
        contraction.observe(1.0, 0.5)
    assert contraction.estimate == pytest.approx(0.5, rel=1e-6)


def test_nothing_to_correct_says_nothing_of_the_contraction():
    contraction = Contraction()
    contraction.observe(0.0, 0.0)
    assert math.isnan(contraction.estimate)
    contraction.observe(2.0, 1.0)
    contraction.observe(0.0, 0.0)
    assert contraction.estimate == 0.5


def test_a_number_that_is_none_is_forgotten():
    contraction = Contraction()
    contraction.observe(1.0, math.inf)
    contraction.observe(math.inf, math.inf)
    for _ in range(3):
        contraction.observe(2.0, 1.0)
    assert contraction.estimate == pytest.approx(0.5)


def test_a_standing_robot_sees_its_corrections_converge(bench):
    played = bench().run(1)
    assert math.isnan(played.commands[0].decision.contraction)
    played.run(99, deliver=nothing)
    # 0.03 measured at 0.05 rad.
    assert 0.0 < played.commands[-1].decision.contraction < 0.2


# ---- what goes wrong


def garbage(answer):
    """One message for each way of being wrong, by the reason it must be counted under."""

    def first(change):
        return altered(answer, lambda fields: fields["factorisations"][0].update(change))

    def negative(fields):
        entry = fields["factorisations"][0]
        entry["P"] = (-np.frombuffer(entry["P"], dtype="<f4")).tobytes()

    def elsewhere(fields):
        entry = fields["factorisations"][0]
        entry["posture"] = (
            np.frombuffer(entry["posture"], dtype="<f4") + np.float32(0.2)
        ).tobytes()

    return {
        "undecodable": answer[:-7],
        "oversized": bytes(50_000),
        "not_finite": first({"posture": np.full(31, np.nan, dtype="<f4").tobytes()}),
        "layout": first({"layout": bytes(8)}),
        "shape": first({"Q": bytes(4)}),
        "mode": first({"mode": 9}),
        "not_inverse": altered(answer, negative),
        "posture": altered(answer, elsewhere),
        "stamp": altered(answer, lambda f: f.update(stamp_ns=f["stamp_ns"] + 1)),
        "version": altered(answer, lambda f: f.update(version=99)),
        "kind": altered(answer, lambda f: f.update(kind="projector")),
        "config": altered(answer, lambda f: f.update(config=bytes(8))),
        "plan": altered(answer, lambda f: f.update(plan=bytes(8))),
        "session": altered(answer, lambda f: f.update(session=SESSION + 1)),
        "future": altered(answer, lambda f: f.update(sequence=f["sequence"] + 1000)),
    }


def test_bad_messages_are_counted_by_reason_and_change_nothing(bench):
    reasons = set()

    def with_garbage(answer):
        reasons.update(garbage(answer))
        bad = list(garbage(answer).values())
        # Before and after the good one, so that neither order lets one in.
        return [*bad, answer, *bad]

    clean = bench(**EVERY_STATE).run(20)
    attacked = bench(**EVERY_STATE).run(20, deliver=with_garbage)
    for name in ("tau", "q", "source"):
        np.testing.assert_array_equal(attacked.column(name), clean.column(name))
    expected = dict.fromkeys(reasons, 2 * 20)
    # What is not newer is stale before it is tried.
    late = ("not_inverse", "posture", "stamp")
    expected.update(dict.fromkeys(late, 20), stale=20 * len(late))
    assert attacked.robot.cache.refused == expected
    assert attacked.column("refused")[-1] == sum(expected.values())


def test_garbage_alone_never_starts_the_robot(bench):
    played = bench().run(5, deliver=lambda answer: list(garbage(answer).values()))
    assert not played.robot.running
    assert set(sources(played)) == {Source.HELD}


def scaled(message, name, scale):
    return dataclasses.replace(
        message,
        factorisations=tuple(
            dataclasses.replace(each, **{name: scale * getattr(each, name)})
            for each in message.factorisations
        ),
    )


def after_an_absurd_factorisation(played, name, scale):
    """Two ticks with one whose numbers are scaled, and then nothing absurd any more.

    It is put into the cache by hand: the robot would not take it from a message.
    """

    def absurd(answer):
        message = scaled(played.codec.decode_factorisations(answer), name, scale)
        with contextlib.suppress(MessageRefused):
            played.robot.cache.keep(
                message.factorisations, sequence=message.sequence, stamp_ns=message.stamp_ns
            )
        return []

    # That numbers overflow on the way is the point; NumPy need not say so.
    with np.errstate(all="ignore"):
        played.run(1).tick(deliver=absurd)
        played.tick(deliver=nothing)
    return played


@pytest.mark.parametrize("level", ["b", "b_adjoint", "c"])
@pytest.mark.parametrize("scale", [1e-30, 1e-10, 1e3, 1e10, 1e30])
@pytest.mark.parametrize("name", ["P", "Q", "T", "A"])
def test_a_well_formed_factorisation_of_absurd_numbers_never_passes_the_clamp(
    bench, name, scale, level
):
    settings = {"correction.level": level, **EVERY_STATE}
    played = after_an_absurd_factorisation(bench(**settings), name, scale)
    with np.errstate(all="ignore"):
        played.run(3, deliver=nothing)
    for command in played.commands:
        assert np.isfinite(command.tau).all()
        assert np.all(np.abs(command.tau) <= played.robot._guard.limit)


def test_a_state_that_is_not_finite_holds_the_joints_for_as_long_as_it_lasts(bench, optimum):
    played = bench(**EVERY_STATE).run(5)
    position = played.robot._plant.data.qpos
    kept = position[20]
    position[20] = np.nan
    # The edge would refuse such a state. For a while the joint is held over.
    for _ in range(HELD_OVER_TICKS + 1):
        played.robot.measure(played.now_ns)
        command = played.robot.command(played.now_ns + DEADLINE_NS)
    assert command.source is Source.HELD
    assert np.isfinite(command.tau).all()
    position[20] = kept
    # Nothing of it is left in the corrections.
    y = played.tick().decision.y
    assert sources(played)[-1] is Source.FRESH
    assert error(y, optimum(played.state)) < SINGLE_PRECISION


@pytest.mark.parametrize("scale", [1e3, 1e10, 1e20, 1e30])
@pytest.mark.parametrize("name", ["P", "Q", "T", "A"])
def test_good_factorisations_make_up_for_an_absurd_one(bench, optimum, name, scale):
    played = after_an_absurd_factorisation(bench(**EVERY_STATE), name, scale)
    # Solutions up to 1e21 have been corrected, each tick to some 1e-7 of what they were.
    y = played.run(3).tick().decision.y
    assert error(y, optimum(played.state)) < SINGLE_PRECISION


def test_a_step_that_gave_nothing_leaves_nothing_behind(bench, optimum):
    played = after_an_absurd_factorisation(bench(**EVERY_STATE), "P", 1e30)
    # The first step gave 1e30, the second none.
    assert [source.name for source in sources(played)] == ["FRESH", "FRESH", "HELD"]
    y = played.tick().decision.y
    assert error(y, optimum(played.state)) < SINGLE_PRECISION
