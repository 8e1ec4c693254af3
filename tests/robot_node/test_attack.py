"""An edge that lies: what a robot does with well-formed messages that are wrong.

For LC, a lie is silence: a robot that gets nothing but lies does in every tick what it does without
an answer, to the last bit. For LA it is so as far as the robot's dynamics tell.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_node.node import EdgeNode
from robot_node.verification import ProjectorVerifier
from shared.wbc.contacts import ContactMode
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.model import WholeBodyModel
from shared.wire.codec import Codec
from tests.messages import altered, make_state
from tests.robot_node.bench import Bench, nothing

HONEST, ATTACKED = 3, 12
# An answer to every state.
EVERY_STATE = {
    "controller": "lc",
    "push": [],
    "correction.refresh_distance": 0.0,
    "correction.refresh_interval_ns": 0,
}


@pytest.fixture(scope="module")
def lc(robot, motion, configured):
    config = configured(**EVERY_STATE)
    return lambda: Bench(robot, motion, config)


@pytest.fixture(scope="module")
def silent(lc):
    """The torques of a robot whose edge falls silent."""
    return lc().run(HONEST).run(ATTACKED, deliver=nothing).column("tau")


def attacked(bench, lie):
    """Each answer replaced by `lie(message, rng)`, from a tick on."""
    rng = np.random.default_rng(0)

    def deliver(answer):
        with np.errstate(over="ignore"):
            return [
                bench.codec.encode_factorisations(
                    lie(bench.codec.decode_factorisations(answer), rng)
                )
            ]

    return bench.run(HONEST).run(ATTACKED, deliver=deliver)


def in_each(message, change):
    """The message with every factorisation changed."""
    factorisations = tuple(change(each) for each in message.factorisations)
    return dataclasses.replace(message, factorisations=factorisations)


def one_block(name, change):
    def lie(message, rng):
        return in_each(
            message,
            lambda each: dataclasses.replace(each, **{name: change(getattr(each, name), rng)}),
        )

    return lie


def check_silence(bench, silent, *, reasons):
    np.testing.assert_array_equal(bench.column("tau"), silent)
    refused = bench.robot.cache.refused
    assert refused.keys() <= reasons
    assert refused.total() == ATTACKED


BLOCKS = st.sampled_from(["P", "Q", "T", "A"])
FACTORS = st.one_of(
    st.floats(-1e12, 0.95), st.floats(1.05, 1e12), st.sampled_from([-1.0, 0.0, 1e6, 1e-6, 1e30])
)


@settings(max_examples=30)
@given(name=BLOCKS, factor=FACTORS)
def test_a_scaled_factorisation_is_silence(lc, silent, name, factor):
    bench = attacked(lc(), one_block(name, lambda block, rng: factor * block))
    check_silence(bench, silent, reasons={"not_inverse"})


@settings(max_examples=20)
@given(name=BLOCKS, relative=st.floats(0.3, 1e3), seed=st.integers(0, 2**32))
def test_a_disturbed_factorisation_is_silence(lc, silent, name, relative, seed):
    noise = np.random.default_rng(seed)

    def disturb(block, rng):
        return block * (1.0 + relative * noise.standard_normal(block.shape))

    bench = attacked(lc(), one_block(name, disturb))
    check_silence(bench, silent, reasons={"not_inverse"})


@pytest.mark.parametrize("name", ["P", "Q", "T"])
def test_a_permuted_factorisation_is_silence(lc, silent, name):
    bench = attacked(lc(), one_block(name, lambda block, rng: block[rng.permutation(len(block))]))
    check_silence(bench, silent, reasons={"not_inverse"})


@settings(max_examples=15)
@given(distance=st.floats(0.15, 10.0), seed=st.integers(0, 2**32), honest_blocks=st.booleans())
def test_the_factorisation_of_a_far_posture_is_silence(
    lc, silent, stacks, model, robot, distance, seed, honest_blocks
):
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], robot.model.nv - 6)

    def there(each):
        q = robot.q_standing.copy()
        q[7:] = each.posture + distance * signs
        stack = stacks[each.mode]
        if honest_blocks:
            return factorise_kkt(stack, stack.matrices(model.jacobians(q)), q[7:])
        return dataclasses.replace(each, posture=q[7:])

    bench = attacked(lc(), lambda message, rng: in_each(message, there))
    check_silence(bench, silent, reasons={"posture"})


@pytest.mark.parametrize("distance", [0.02, 0.05])
def test_the_blocks_of_a_near_posture_under_the_true_name_are_silence(
    lc, silent, stacks, model, robot, distance
):
    def there(each):
        q = robot.q_standing.copy()
        q[7:] = each.posture + distance
        stack = stacks[each.mode]
        elsewhere = factorise_kkt(stack, stack.matrices(model.jacobians(q)), q[7:])
        return dataclasses.replace(elsewhere, posture=each.posture)

    bench = attacked(lc(), lambda message, rng: in_each(message, there))
    check_silence(bench, silent, reasons={"not_inverse"})


def test_the_factorisation_of_the_other_foot_is_silence(lc, silent):
    def exchange(message, rng):
        both, left, right = message.factorisations
        wrong = (
            both,
            dataclasses.replace(right, mode=left.mode),
            dataclasses.replace(left, mode=right.mode),
        )
        return dataclasses.replace(message, factorisations=wrong)

    # All three contact modes are sent at first only, so the lie comes then.
    bench = lc()

    def deliver(answer):
        message = exchange(bench.codec.decode_factorisations(answer), None)
        return [bench.codec.encode_factorisations(message)]

    bench.tick(deliver=deliver)
    assert bench.robot.cache.refused == {"not_inverse": 1}
    assert not bench.robot.running


@pytest.mark.parametrize(
    ("field", "change", "reason"),
    [
        ("stamp_ns", lambda value: value + 1, "stamp"),
        ("stamp_ns", lambda value: 2**62, "stamp"),
        ("stamp_ns", lambda value: -1, "stamp"),
        ("sequence", lambda value: value + 5, "future"),
        ("sequence", lambda value: 2**62, "future"),
        ("session", lambda value: value ^ 1, "session"),
    ],
)
def test_an_answer_to_a_state_that_was_not_sent_is_silence(lc, silent, field, change, reason):
    bench = lc().run(HONEST)
    bench.run(
        ATTACKED,
        deliver=lambda answer: [altered(answer, lambda f: f.update({field: change(f[field])}))],
    )
    check_silence(bench, silent, reasons={reason})


def test_numbers_that_are_none_are_silence(lc, silent):
    def poison(block, rng):
        block = block.copy()
        # On the diagonal: of P and T one triangle is sent, and of A the first rows.
        k = rng.integers(3)
        block[k, k] = np.nan
        return block

    for name in ("P", "Q", "T", "A"):
        check_silence(attacked(lc(), one_block(name, poison)), silent, reasons={"not_finite"})


def test_an_error_that_the_test_does_not_see_hardly_changes_the_torques(lc):
    """Where the test ends: a part in ten thousand of each number."""
    honest = lc().run(HONEST + ATTACKED).column("tau")

    def disturb(block, rng):
        return block * (1.0 + 1e-4 * rng.standard_normal(block.shape))

    for name in ("P", "Q", "A"):
        bench = attacked(lc(), one_block(name, disturb))
        if bench.robot.cache.refused:
            assert bench.robot.cache.refused.keys() == {"not_inverse"}
            continue
        tau = bench.column("tau")
        assert np.abs(tau - honest).max() < 0.02 * np.abs(honest).max()


def test_a_robot_that_hears_lies_only_never_starts(lc):
    bench = lc()
    lie = one_block("Q", lambda block, rng: -block)

    def deliver(answer):
        message = lie(bench.codec.decode_factorisations(answer), None)
        return [bench.codec.encode_factorisations(message)]

    bench.run(5, deliver=deliver)
    assert not bench.robot.running
    assert bench.robot.cache.refused == {"not_inverse": 5}


def test_lies_before_and_after_the_truth_change_nothing(lc):
    honest = lc().run(HONEST + ATTACKED).column("tau")
    bench = lc().run(HONEST)
    lie = one_block("P", lambda block, rng: 1e6 * block)

    def deliver(answer):
        message = lie(bench.codec.decode_factorisations(answer), None)
        wrong = bench.codec.encode_factorisations(message)
        return [wrong, answer, wrong]

    bench.run(ATTACKED, deliver=deliver)
    np.testing.assert_array_equal(bench.column("tau"), honest)


# ---- LA


@pytest.fixture(scope="module")
def la(robot, motion, configured):
    config = configured(controller="la", push=[])
    return lambda: Bench(robot, motion, config)


def projectors_changed(change):
    def lie(message):
        return dataclasses.replace(
            message,
            projectors=tuple(
                dataclasses.replace(
                    timed,
                    projector=dataclasses.replace(
                        timed.projector, A_dagger=change(timed.projector.A_dagger)
                    ),
                )
                for timed in message.projectors
            ),
        )

    return lie


LIES = {
    "×10⁶": lambda A: 1e6 * A,
    "×10³⁰⁰": lambda A: 1e300 * A,
    "× −1": lambda A: -A,
    "nothing": lambda A: 0.0 * A,
    "half": lambda A: 0.5 * A,
    "double": lambda A: 2.0 * A,
    "rows exchanged": lambda A: A[::-1].copy(),
    "columns exchanged": lambda A: A[:, ::-1].copy(),
    "no forces": lambda A: np.vstack([A[:37], np.zeros_like(A[37:])]),
}


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
@pytest.mark.parametrize("first", [True, False])
def test_a_projector_against_the_dynamics_is_refused_and_the_true_one_used(la, lie, first):
    honest = la().run(HONEST + ATTACKED).column("tau")
    bench = la().run(HONEST)
    change = projectors_changed(lie)

    def deliver(answer):
        wrong = bench.codec.encode_projector(change(bench.codec.decode_projector(answer)))
        return [wrong, answer] if first else [answer, wrong]

    with np.errstate(all="ignore"):
        bench.run(ATTACKED, deliver=deliver)
    np.testing.assert_array_equal(bench.column("tau"), honest)
    # The first of two answers to the same state is tested first.
    assert bench.robot.cache.refused == ({"dynamics": ATTACKED} if first else {})


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_projectors_against_the_dynamics_alone_are_silence(la, lie):
    silent = la().run(HONEST).run(ATTACKED, deliver=nothing).column("tau")
    bench = la().run(HONEST)
    with np.errstate(all="ignore"):
        bench.run(ATTACKED, deliver=bench.doctored(projectors_changed(lie)))
    np.testing.assert_array_equal(bench.column("tau"), silent)
    assert bench.robot.cache.refused == {"dynamics": ATTACKED}


def test_a_projector_that_is_never_valid_does_not_hide_the_last_one(la):
    silent = la().run(HONEST).run(ATTACKED, deliver=nothing).column("tau")
    bench = la().run(HONEST)

    def never(message):
        timed = tuple(
            dataclasses.replace(each, valid_from_ns=0, valid_until_ns=0)
            for each in message.projectors
        )
        return dataclasses.replace(message, projectors=timed)

    bench.run(ATTACKED, deliver=bench.doctored(never))
    np.testing.assert_array_equal(bench.column("tau"), silent)


def test_a_projector_that_obeys_the_dynamics_but_wants_another_motion_is_not_seen(la):
    """Where the test ends: the trade-off between tasks is the edge's to choose."""
    bench = la().run(HONEST)
    layout = bench.robot._codec._layouts[ContactMode.DOUBLE_SUPPORT]
    tasks = slice(layout.slice("com").start, layout.slice("bounds").start)

    def backwards(A):
        A = A.copy()
        A[:, tasks] *= -1.0
        return A

    bench.run(ATTACKED, deliver=bench.doctored(projectors_changed(backwards)))
    assert not bench.robot.cache.refused


@pytest.fixture(scope="module")
def limited(robot, motion, configured):
    """LA with torque limits so low that it needs the pushes of every answer."""
    config = configured(
        controller="la", push=[], **{"wbc.limits.torque": True, "wbc.limits.torque_fraction": 0.15}
    )
    return lambda: Bench(robot, motion, config)


def open_rows_changed(**changes):
    """Change arrays of a projector, or of its open rows."""

    def lie(message):
        def changed(projector):
            opened = dataclasses.replace(
                projector.open,
                **{
                    name: change(getattr(projector.open, name))
                    for name, change in changes.items()
                    if name != "A_dagger"
                },
            )
            A_dagger = changes.get("A_dagger", lambda A: A)(projector.A_dagger)
            return dataclasses.replace(projector, A_dagger=A_dagger, open=opened)

        timed = tuple(
            dataclasses.replace(each, projector=changed(each.projector))
            for each in message.projectors
        )
        return dataclasses.replace(message, projectors=timed)

    return lie


OPEN_LIES = {
    "pushes × −1": open_rows_changed(push=lambda push: -push),
    "pushes × 1.1": open_rows_changed(push=lambda push: 1.1 * push),
    "pushes × 10⁶": open_rows_changed(push=lambda push: 1e6 * push),
    "no pushes": open_rows_changed(push=lambda push: 0.0 * push),
    "pushes exchanged": open_rows_changed(push=lambda push: push[:, ::-1].copy()),
    "a factor × 0.9": open_rows_changed(factor=lambda factor: 0.9 * factor),
    "no factor": open_rows_changed(factor=lambda factor: 0.0 * factor),
    "both × 10³⁰": open_rows_changed(
        push=lambda push: 1e30 * push, factor=lambda factor: 1e30 * factor
    ),
    "other limits": open_rows_changed(limits=lambda limits: np.arange(len(limits))),
    # It obeys the dynamics.
    "tasks × −1": open_rows_changed(A_dagger=lambda A: np.hstack([A[:, :18], -A[:, 18:]])),
}


@pytest.mark.parametrize("lie", OPEN_LIES.values(), ids=OPEN_LIES)
def test_open_rows_that_are_not_the_robots_own_are_silence(limited, lie):
    silent = limited().run(HONEST).run(ATTACKED, deliver=nothing).column("tau")
    bench = limited().run(HONEST)
    with np.errstate(all="ignore"):
        bench.run(ATTACKED, deliver=bench.doctored(lie))
    np.testing.assert_array_equal(bench.column("tau"), silent)
    assert bench.robot.cache.refused == {"open_rows": ATTACKED}


def test_open_rows_that_no_inequality_needs_are_not_tested(robot, motion, configured):
    """The test takes time, and pushes that are not used do no harm."""
    config = configured(controller="la", push=[], **{"wbc.limits.torque": True})
    honest = Bench(robot, motion, config).run(HONEST + ATTACKED).column("tau")
    bench = Bench(robot, motion, config).run(HONEST)
    bench.run(ATTACKED, deliver=bench.doctored(OPEN_LIES["pushes × −1"]))
    np.testing.assert_array_equal(bench.column("tau"), honest)
    assert not bench.robot.cache.refused


@pytest.mark.parametrize("spread", [1, 5, 9])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_an_honest_projector_is_exact_at_its_own_state(
    robot, motion, configured, stacks, states, spread, dtype
):
    config = configured(**{"wire.projector_dtype": dtype})
    codec, edge = Codec(robot, config, motion), EdgeNode(robot, config, motion)
    q, v = states[spread]
    rng = np.random.default_rng(0)
    verifier = ProjectorVerifier(WholeBodyModel(robot), stacks, motion.reference(0), rng)
    for mode in ContactMode:
        edge.receive(codec.encode_state(make_state(robot, session=mode, q=q, v=v, mode=mode)), 0)
        answer = edge.step()
        assert answer is not None
        assert answer.data is not None
        (timed,) = codec.decode_projector(answer.data).projectors
        assert verifier.is_exact(timed.projector, q, v)
        wrong = dataclasses.replace(timed.projector, A_dagger=1.05 * timed.projector.A_dagger)
        assert not verifier.is_exact(wrong, q, v)
