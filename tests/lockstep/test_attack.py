"""An edge that lies to LC while the robot is pushed: silence is the worst that it can do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from experiments.lockstep import Lockstep
from shared.config.config_file import load_config
from shared.errors import LinkError
from shared.wire.codec import Codec

SETTINGS = {
    "controller": "lc",
    "duration": 1.6,
    "push": ["100N@0.3s:0.2s:+y"],
    "link.network": "constant:20ms",
    # Many answers: a chance to lie each time that the robot has moved at all.
    "correction.refresh_distance": 0.0,
}
# Joints of the legs, by sides: hip yaw, roll, pitch, knee, ankle pitch, roll.
PITCH = [2, 3, 4, 8, 9, 10]


def trial(**changes):
    settings = load_config(None, {"seed": 0, **SETTINGS, **changes})
    return Lockstep(settings, all_active_sets=False)


def attacked(monkeypatch, lie, **changes):
    """A trial in which each answer but the first has passed through `lie(message, number)`."""
    lockstep = trial(**changes)
    robot, config = lockstep.robot._model.robot, lockstep.config
    codec = Codec(robot, config, lockstep.robot._motion)
    honest, sent = lockstep.edge.step, [0]

    def step():
        answer = honest()
        if answer is None or answer.data is None:
            return answer
        sent[0] += 1
        if sent[0] == 1:
            return answer
        message = lie(codec.decode_factorisations(answer.data), sent[0])
        return dataclasses.replace(answer, data=codec.encode_factorisations(message))

    monkeypatch.setattr(lockstep.edge, "step", step)
    return lockstep.run()


def test_a_robot_that_hears_nothing_but_lies_stands_its_push(monkeypatch):
    def lie(message, number):
        factor = (-1.0, 1e6, 0.0, 1.5, -1e-3)[number % 5]
        name = "PQTA"[number % 4]
        return dataclasses.replace(
            message,
            factorisations=tuple(
                dataclasses.replace(each, **{name: factor * getattr(each, name)})
                for each in message.factorisations
            ),
        )

    result = attacked(monkeypatch, lie)
    assert not result.summary["fell"]
    refused = result.summary["link"]["downlink"]["refused"]
    assert refused.keys() == {"not_inverse"}
    assert refused["not_inverse"] > 50
    # Nothing but the first factorisation was ever used.
    sequences = result.schema.column(result.rows, "projector_sequence")
    assert set(np.unique(sequences[sequences >= 0])) == {0}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_true_blocks_of_the_worst_posture_that_is_near_enough_do_not_make_it_fall(sign):
    """What a lie can still choose: a posture within the bound. Half as far again is refused.

    Pitch joints leave the largest contraction of the directions tried, 0.33.
    """
    lockstep = trial()
    wrong = np.zeros(31)
    wrong[PITCH] = sign
    # Root mean square: near the bound of 0.09 rad, which the edge's noise and look-ahead share.
    wrong *= 0.08 * np.sqrt(31 / np.square(wrong).sum())
    lockstep.edge._posture_error = wrong
    result = lockstep.run()
    assert not result.summary["fell"]
    assert result.summary["link"]["downlink"]["sent"] > 50
    contraction = result.schema.column(result.rows, "contraction")
    assert np.nanmax(contraction) < 0.5

    further = trial(**{"loop.connect_timeout": 0.1})
    further.edge._posture_error = 1.5 * wrong
    with pytest.raises(LinkError, match="posture"):
        further.run()


@pytest.mark.parametrize(
    ("glitches", "refused"),
    [({150: 50.0, 450: 50.0, 451: 50.0}, {"limits": 3}), ({150: 0.6, 450: -0.45, 451: -0.45}, {})],
)
def test_a_glitch_in_one_state_on_its_way_does_not_make_lc_fall(monkeypatch, glitches, refused):
    """A joint of a state is wrong as the edge sees it: the answer that follows is of no harm."""
    lockstep = trial()
    codec = lockstep._codec
    honest = lockstep.edge.receive

    def receive(data, now_ns):
        state = codec.decode_state(data)
        if state.sequence in glitches:
            q = state.q.copy()
            q[9] += glitches[state.sequence]
            data = codec.encode_state(dataclasses.replace(state, q=q))
        honest(data, now_ns)

    monkeypatch.setattr(lockstep.edge, "receive", receive)
    result = lockstep.run()
    assert not result.summary["fell"]
    assert result.summary["link"]["uplink"]["refused"] == refused
