from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robot_node.cache import CacheEntry
from robot_node.controllers import (
    LocallyAssisted,
    Measurement,
    PurelyRemote,
    Source,
    make_controller,
)
from shared.errors import ConfigError
from shared.wbc.contacts import ContactMode
from shared.wbc.torque import recover_torque
from tests.messages import make_answer


@pytest.fixture
def stack(stacks):
    return stacks[ContactMode.DOUBLE_SUPPORT]


@pytest.fixture
def entry(stack, rng):
    message = make_answer(stack, rng)
    return CacheEntry(message.projectors[0], 0, 0, tau=message.tau, y=message.y)


@pytest.fixture
def now(stack, model, states, reference):
    q, v = states[1]
    return Measurement(q, v, stack.right_hand_side(model.kinematics(q, v), reference))


def test_purely_remote_applies_the_torque_received(model, stacks, stack, entry, now):
    tau, y = PurelyRemote().command(entry, now)
    np.testing.assert_array_equal(tau, entry.tau)
    np.testing.assert_array_equal(y, entry.y)


def test_locally_assisted_applies_the_projector_to_a_fresh_b(model, stacks, stack, entry, now):
    tau, y = LocallyAssisted(model, stacks).command(entry, now)
    np.testing.assert_array_equal(y, entry.projector.A_dagger @ now.b)
    expected = recover_torque(model, stack.contacts, now.q, now.v, y)
    np.testing.assert_array_equal(tau, expected)


def test_locally_assisted_does_not_use_the_torque_received(model, stacks, stack, entry, now):
    tau, y = LocallyAssisted(model, stacks).command(entry, now)
    other = dataclasses.replace(entry, tau=np.zeros(31), y=np.zeros(61))
    again, y_again = LocallyAssisted(model, stacks).command(other, now)
    np.testing.assert_array_equal(again, tau)
    np.testing.assert_array_equal(y_again, y)


def test_controllers_are_made_by_their_names(model, stacks):
    assert isinstance(make_controller("pr", model, stacks), PurelyRemote)
    assert isinstance(make_controller("la", model, stacks), LocallyAssisted)


def test_an_unknown_controller_is_refused_with_the_names_that_exist(model, stacks):
    with pytest.raises(ConfigError, match=r"la.*pr.*'pid'"):
        make_controller("pid", model, stacks)


def test_sources_are_the_numbers_of_the_telemetry():
    assert [(source.name, int(source)) for source in Source] == [
        ("FRESH", 0),
        ("CACHED", 1),
        ("HELD", 2),
        ("ON_BOARD", 3),
    ]
