"""The largest messages of every robot of the catalogue fit into their channels."""

from __future__ import annotations

import pytest

from shared.config.config_file import load_config
from shared.motion.standing import Standing
from shared.robots import CATALOGUE, load_robot
from shared.wbc.answer import TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.stack import Stack
from shared.wire.channels import DOWNLINK, UPLINK
from shared.wire.codec import Codec
from tests.messages import make_answer, make_correction, make_projector, make_state


@pytest.fixture(params=CATALOGUE)
def robot(request):
    return load_robot(request.param)


@pytest.fixture
def stacks(robot):
    config = load_config(None, {"robot.name": robot.name})
    return [Stack(robot, config.wbc, mode) for mode in ContactMode]


@pytest.fixture
def codec_of(robot):
    def build(task):
        config = load_config(None, {"robot.name": robot.name, "task": task})
        return Codec(robot, config, Standing(robot))

    return build


def test_a_state_fits(codec_of, robot):
    far = 2**62
    state = make_state(robot, sequence=far, stamp_ns=far, time_ns=far, held_sequences=3 * (far,))
    assert len(codec_of("walk").encode_state(state)) <= UPLINK.max_bytes


def test_the_answer_to_a_robot_that_stands_fits(codec_of, stacks, rng):
    answer = codec_of("balance").encode_projector(make_answer(stacks[0], rng))
    assert len(answer) <= DOWNLINK.max_bytes


def test_the_projectors_of_all_modes_fit_into_one_answer_to_a_robot_that_walks(
    codec_of, stacks, rng
):
    timed = tuple(TimedProjector(make_projector(stack, rng), 2**62, 2**62) for stack in stacks)
    answer = codec_of("walk").encode_projector(make_answer(stacks[0], rng, projectors=timed))
    assert len(answer) <= DOWNLINK.max_bytes


def test_the_factorisations_of_all_modes_fit_into_one_answer(codec_of, stacks, rng):
    answer = codec_of("walk").encode_factorisations(make_correction(stacks, rng))
    assert len(answer) <= DOWNLINK.max_bytes
