from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robot_node.cache import CacheEntry, ProjectorCache
from robot_node.controllers import LocallyAssisted, PurelyRemote, Source
from robot_node.corrected import LocallyCorrected
from robot_node.node import RobotNode
from shared.errors import ConfigError
from shared.report import SOURCES
from shared.wbc.contacts import ContactMode
from shared.wbc.torque import recover_torque
from shared.wire.codec import Codec
from shared.wire.messages import TimedProjector
from tests.messages import make_answer, make_projector

SESSION = 5
DOUBLE, LEFT, RIGHT = ContactMode


@pytest.fixture(scope="module")
def codec(robot, config, motion):
    return Codec(robot, config, motion)


@pytest.fixture
def cache(codec):
    return ProjectorCache(codec, session=SESSION)


@pytest.fixture
def stack(stacks):
    return stacks[DOUBLE]


@pytest.fixture
def answer(stack, rng):
    return make_answer(stack, rng, session=SESSION, sequence=3, stamp_ns=11)


@pytest.fixture
def now(states):
    return states[1]


def offer(cache, codec, answer):
    assert cache.offer(codec.encode_projector(answer), newest_sent=10)


def test_purely_remote_applies_the_torque_received(cache, codec, answer, now, reference):
    offer(cache, codec, answer)
    controller = PurelyRemote(cache)
    controller.observe(*now, reference)
    decision = controller.command(time_ns=0)
    np.testing.assert_array_equal(decision.tau, answer.tau)
    np.testing.assert_array_equal(decision.y, answer.y)


def test_locally_assisted_applies_the_projector_to_a_fresh_b(
    cache, codec, answer, model, stacks, stack, now, reference
):
    offer(cache, codec, answer)
    controller = LocallyAssisted(cache, model, stacks)
    controller.observe(*now, reference)
    decision = controller.command(time_ns=0)
    b = stack.right_hand_side(model.kinematics(*now), reference)
    y = answer.projectors[0].projector.A_dagger @ b
    np.testing.assert_array_equal(decision.y, y)
    expected = recover_torque(model, stack.contacts, *now, y)
    np.testing.assert_array_equal(decision.tau, expected)


def test_locally_assisted_does_not_use_the_torque_received(
    codec, answer, model, stacks, now, reference
):
    decisions = []
    for other in (answer, dataclasses.replace(answer, tau=np.zeros(31), y=np.zeros(61))):
        cache = ProjectorCache(codec, session=SESSION)
        offer(cache, codec, other)
        controller = LocallyAssisted(cache, model, stacks)
        controller.observe(*now, reference)
        decisions.append(controller.command(time_ns=0))
    np.testing.assert_array_equal(decisions[0].tau, decisions[1].tau)
    np.testing.assert_array_equal(decisions[0].y, decisions[1].y)


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_a_decision_names_the_answer_behind_it(
    cache, codec, answer, model, stacks, now, reference, controller
):
    offer(cache, codec, answer)
    made = LocallyAssisted(cache, model, stacks) if controller == "la" else PurelyRemote(cache)
    made.observe(*now, reference)
    decision = made.command(time_ns=0)
    projector = answer.projectors[0].projector
    assert (decision.sequence, decision.stamp_ns) == (3, 11)
    assert decision.mode is DOUBLE
    assert decision.active_set == sum(1 << row for row in projector.active)
    # What it is called if its answer is not to this very state.
    assert decision.source is Source.CACHED
    # Nothing was corrected.
    assert np.isnan(decision.contraction)
    assert np.isnan(decision.staleness)


def test_without_an_answer_there_is_no_decision(cache, model, stacks, now, reference):
    for controller in (PurelyRemote(cache), LocallyAssisted(cache, model, stacks)):
        controller.observe(*now, reference)
        assert controller.command(time_ns=0) is None


def test_locally_assisted_never_uses_a_projector_of_another_mode(
    cache, codec, answer, model, stacks, now, reference
):
    offer(cache, codec, answer)
    controller = LocallyAssisted(cache, model, stacks)
    controller.observe(*now, dataclasses.replace(reference, mode=LEFT))
    assert controller.command(time_ns=0) is None


def test_what_was_solved_on_board_is_named(cache, model, stacks, stack, now, reference, rng):
    timed = TimedProjector(make_projector(stack, rng), 0, 100)
    cache.keep(CacheEntry(timed, 4, 12, on_board=True))
    controller = LocallyAssisted(cache, model, stacks)
    controller.observe(*now, reference)
    assert controller.command(time_ns=99).source is Source.ON_BOARD
    assert controller.command(time_ns=100) is None


@pytest.mark.parametrize(
    ("name", "controller", "ages"),
    [
        ("pr", PurelyRemote, True),
        ("la", LocallyAssisted, True),
        ("lc", LocallyCorrected, False),
    ],
)
def test_controllers_are_made_by_their_names(robot, motion, configured, name, controller, ages):
    node = RobotNode(robot, configured(controller=name), motion)
    made = node.controller
    assert isinstance(made, controller)
    assert made.cache is node.cache
    assert made.ages is ages
    assert not made.doubtful


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
    assert tuple(source.name.lower() for source in Source) == SOURCES
