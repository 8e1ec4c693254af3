"""Same configuration and seed, same run to the last bit; and what must not make a difference."""

from __future__ import annotations

import numpy as np
import pytest

SHORT = {"duration": 0.6, "push": ["100N@0.1s:0.2s:+y"]}
# Delays that change, losses, noise: every source of randomness of a trial takes part.
ROUGH = {**SHORT, "link.network": "factory/003", "link.loss": 0.2}


CONTROLLERS = ("la", "pr")


def log_hash(result):
    return result.summary["log_hash"]


def test_the_same_seed_gives_the_same_run(play):
    first, second = play(**ROUGH), play(again=True, **ROUGH)
    assert first is not second
    assert log_hash(first) == log_hash(second)
    np.testing.assert_array_equal(first.link_rows, second.link_rows)


def test_another_seed_gives_another_run(play):
    assert log_hash(play(**ROUGH)) != log_hash(play(**ROUGH, seed=1))


@pytest.mark.parametrize("key", ["sensors.joint_position_noise", "link.loss"])
def test_a_seed_matters_because_of_noise_and_of_loss(play, key):
    # The path itself is constant; each of the two alone must depend on the seed.
    calm = {
        **SHORT,
        "link.network": "constant:5ms",
        "sensors.joint_position_noise": 0.0,
        "link.loss": 0.0,
    }
    assert log_hash(play(**calm)) == log_hash(play(**calm, seed=1))
    changed = {**calm, key: 0.01 if key.startswith("sensors") else 0.3}
    assert log_hash(play(**changed)) != log_hash(play(**changed, seed=1))


def test_without_delay_both_controllers_are_the_same_controller(play):
    network = {"link.network": "constant:0ms"}
    runs = [play(**SHORT, **network, controller=name) for name in CONTROLLERS]
    assert log_hash(runs[0]) == log_hash(runs[1])
    for run in runs:
        assert run.summary["commands"] == {
            "fresh": 600,
            "cached": 0,
            "held": 0,
            "on_board": 0,
            "corrected": 0,
            "stopping": 0,
        }


def test_with_delay_they_are_not(play):
    network = {"link.network": "constant:5ms"}
    runs = [play(**SHORT, **network, controller=name) for name in CONTROLLERS]
    assert log_hash(runs[0]) != log_hash(runs[1])


def test_no_link_is_a_link_without_delay(play):
    direct = play(**SHORT, **{"link.network": "direct"})
    constant = play(**SHORT, **{"link.network": "constant:0ms"})
    assert log_hash(direct) == log_hash(constant)
    assert len(direct.link_rows) == 0
    assert len(constant.link_rows) == 1200


def test_a_trial_does_not_depend_on_the_one_before(play):
    # One process plays hundreds of trials in a sweep.
    play(**SHORT, controller="pr", seed=5, **{"link.network": "constant:40ms"})
    first = log_hash(play(**ROUGH))
    assert log_hash(play(again=True, **ROUGH)) == first


def test_both_back_ends_play_the_same_run_but_for_rounding(play):
    runs = [
        play(duration=0.3, **{"link.network": "constant:10ms", "wbc.solver": name})
        for name in ("daqp", "proxsuite")
    ]
    # Contacts magnify a difference of 1e-12 a little in every tick; 0.3 s leave it far below this.
    q = [run.schema.column(run.rows, "q") for run in runs]
    np.testing.assert_allclose(q[0], q[1], atol=1e-7)
