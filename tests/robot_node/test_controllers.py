from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robot_node.cache import CacheEntry
from robot_node.controllers import ControllerParts, LocallyAssisted, PurelyRemote
from robot_node.corrected import LocallyCorrected
from robot_node.node import RobotNode
from robot_node.onboard import ModelledComputer, factorisation_solve, projector_solve
from shared.config.extensions import CONTROLLERS
from shared.errors import ConfigError
from shared.motion.plan import make_motion
from shared.telemetry.schema import Source
from shared.wbc.answer import TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.torque import recover_torque
from shared.wbc.whole_body import WholeBodyController
from shared.wire.codec import Codec
from tests.messages import STAMP_NS, make_answer, make_projector, sent_states

SESSION = 5
DOUBLE, LEFT, RIGHT = ContactMode


@pytest.fixture(scope="module")
def codec(robot, config, motion):
    return Codec(robot, config, motion)


@pytest.fixture
def parts(config, motion, codec, model, stacks):
    return ControllerParts(
        config=config,
        motion=motion,
        codec=codec,
        session=SESSION,
        model=model,
        stacks=stacks,
        start_computer=lambda make_solve: pytest.fail("there is no contact switch to compute for"),
    )


@pytest.fixture
def pr(parts):
    return PurelyRemote(parts)


@pytest.fixture
def la(parts):
    return LocallyAssisted(parts)


@pytest.fixture
def stack(stacks):
    return stacks[DOUBLE]


@pytest.fixture
def now(states):
    return states[1]


@pytest.fixture
def answer(robot, config, motion, now, stack, rng):
    """An answer to the present state: the true projector, with any torque and solution."""
    controller = WholeBodyController(robot, config, motion)
    timed = controller.projector_for(*now, time_ns=0)
    changes = {"session": SESSION, "sequence": 3, "projectors": (timed,)}
    return make_answer(stack, rng, **changes)


def offer(controller, codec, answer, *, state=None):
    sent = sent_states(state=state)
    assert controller.cache.offer(codec.encode_projector(answer), sent=sent)


def test_purely_remote_applies_the_torque_received(pr, codec, answer, now, reference):
    offer(pr, codec, answer)
    pr.observe(*now, reference)
    decision = pr.command(time_ns=0)
    np.testing.assert_array_equal(decision.tau, answer.tau)
    np.testing.assert_array_equal(decision.y, answer.y)


def test_locally_assisted_applies_the_projector_to_a_fresh_b(
    la, codec, answer, model, stack, now, reference
):
    offer(la, codec, answer)
    la.observe(*now, reference)
    decision = la.command(time_ns=0)
    b = stack.right_hand_side(model.kinematics(*now), reference)
    y = answer.projectors[0].projector.A_dagger @ b
    np.testing.assert_array_equal(decision.y, y)
    q, v = now
    expected = recover_torque(model, stack.contacts, q, v, y)
    np.testing.assert_array_equal(decision.tau, expected)


def test_locally_assisted_does_not_use_the_torque_received(parts, codec, answer, now, reference):
    decisions, (q, v) = [], now
    for other in (answer, dataclasses.replace(answer, tau=np.zeros(31), y=np.zeros(61))):
        controller = LocallyAssisted(parts)
        offer(controller, codec, other)
        controller.observe(q, v, reference)
        decisions.append(controller.command(time_ns=0))
    np.testing.assert_array_equal(decisions[0].tau, decisions[1].tau)
    np.testing.assert_array_equal(decisions[0].y, decisions[1].y)


@pytest.mark.parametrize("kind", [LocallyAssisted, PurelyRemote])
def test_a_decision_names_the_answer_behind_it(parts, codec, answer, now, reference, kind):
    made = kind(parts)
    offer(made, codec, answer)
    made.observe(*now, reference)
    decision = made.command(time_ns=0)
    projector = answer.projectors[0].projector
    assert (decision.sequence, decision.stamp_ns) == (3, STAMP_NS)
    assert decision.mode is DOUBLE
    assert decision.active_set == sum(1 << row for row in projector.active)
    # What it is called if its answer is not to this very state.
    assert decision.source is Source.CACHED
    # Nothing was corrected.
    assert np.isnan(decision.contraction)
    assert np.isnan(decision.staleness)


def test_without_an_answer_there_is_no_decision(pr, la, now, reference):
    for controller in (pr, la):
        controller.observe(*now, reference)
        assert controller.command(time_ns=0) is None


def test_locally_assisted_never_uses_a_projector_of_another_mode(la, codec, answer, now, reference):
    offer(la, codec, answer)
    la.observe(*now, dataclasses.replace(reference, mode=LEFT))
    assert la.command(time_ns=0) is None


def test_what_was_solved_on_board_is_named(la, stack, now, reference, rng):
    timed = TimedProjector(make_projector(stack, rng), 0, 100)
    la.cache.keep(CacheEntry(timed, 4, 12, on_board=True, proven=True))
    la.observe(*now, reference)
    assert la.command(time_ns=99).source is Source.ON_BOARD
    assert la.command(time_ns=100) is None


@pytest.mark.parametrize(
    ("name", "controller"),
    [("pr", PurelyRemote), ("la", LocallyAssisted), ("lc", LocallyCorrected)],
)
def test_controllers_are_made_by_their_names(robot, motion, configured, name, controller):
    node = RobotNode(robot, configured(controller=name), motion)
    made = node.controller
    assert type(made) is controller
    assert made.cache is node.cache
    # LC is sent a factorisation now and then, which never expires.
    assert made.every_state_answered is made.answers_expire is (name != "lc")
    assert made.bounds_torque_steps is (name == "lc")
    assert not made.should_stop()


def test_every_controller_of_the_table_can_be_made(robot, motion, configured):
    for name in CONTROLLERS.own:
        RobotNode(robot, configured(controller=name), motion)


@pytest.mark.parametrize(
    ("settings", "solve"),
    [
        ({"controller": "pr", "task": "walk"}, None),
        ({"controller": "la"}, None),
        ({"controller": "la", "task": "walk"}, projector_solve),
        (
            {
                "controller": "la",
                "task": "walk",
                "switch.prepare_on_board": False,
                "switch.solve_on_board": False,
            },
            None,
        ),
        ({"controller": "lc", "task": "walk"}, None),
        ({"controller": "lc", "correction.on_board_budget": 0.1}, factorisation_solve),
    ],
)
def test_a_controller_starts_the_on_board_computer_that_it_needs(
    robot, configured, settings, solve
):
    started = []

    def start(make_solve):
        started.append(make_solve)
        return ModelledComputer(lambda q, v, target: None, ready_after_ns=0)

    config = configured(**settings)
    node = RobotNode(robot, config, make_motion(robot, config), start_computer=start)
    assert started == ([] if solve is None else [solve])
    assert (node.on_board is None) is (solve is None)


def test_an_unknown_controller_is_refused_with_the_names_that_exist(configured):
    with pytest.raises(ConfigError, match=r"la.*lc.*pr.*'pid'"):
        configured(controller="pid")


def test_sources_are_the_numbers_of_the_telemetry():
    assert [(source.name, int(source)) for source in Source] == [
        ("FRESH", 0),
        ("CACHED", 1),
        ("HELD", 2),
        ("ON_BOARD", 3),
        ("CORRECTED", 4),
        ("STOPPING", 5),
    ]


def test_sources_have_the_names_of_the_reports():
    labels = ("fresh", "cached", "held", "on_board", "corrected", "stopping")
    assert tuple(source.label for source in Source) == labels
