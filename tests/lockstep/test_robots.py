"""Every robot of the catalogue balances and walks; the default one does in all the other tests."""

from __future__ import annotations

import numpy as np
import pytest

from shared.config.settings import RunConfig
from shared.robots import CATALOGUE
from tests.lockstep.conftest import SHORT_STANDS

OTHERS = [name for name in CATALOGUE if name != RunConfig().robot.name]
# Locally assisted and locally corrected, each over a delay that it takes.
LA, LC = ("la", "constant:25ms"), ("lc", "constant:400ms")

# Each is played once by each robot.
each_robot = pytest.mark.parametrize("name", OTHERS)


def com_error(result):
    return result.schema.column(result.rows, "com_error_m")


@each_robot
def test_it_takes_a_push_and_comes_back(play, name):
    controller, network = LA
    result = play(
        duration=3.0, controller=controller, **{"robot.name": name, "link.network": network}
    )
    assert not result.summary["fell"]
    assert result.summary["commands"]["held"] == 0
    error = com_error(result)
    # Talos: 12 cm, of which 6 are left 1.8 s after the push. iCub, with the least push: 3.2 cm.
    assert error.max() > 0.03
    assert error[-1] < 0.6 * error.max()


@each_robot
def test_it_stands_an_outage_without_a_push(play, name):
    """A projector of 0.2 s ago fells iCub, one of 0.27 s ago G1: both hold their joints first."""
    result = play(
        push=[],
        duration=1.0,
        controller="la",
        **{
            "robot.name": name,
            "link.network": "constant:10ms",
            "link.outage": ["400ms@200ms"],
        },
    )
    assert not result.summary["fell"]


@each_robot
def test_it_walks_to_where_the_plan_ends(play, name):
    controller, network = LC
    result = play(
        task="walk",
        controller=controller,
        **{"robot.name": name, "link.network": network, "walk.steps": 2, **SHORT_STANDS},
    )
    assert not result.summary["fell"]
    assert result.summary["commands"]["held"] == 0
    com, reference = (
        result.schema.column(result.rows, name)[-1] for name in ("com", "com_reference")
    )
    # One advancing step, and one that brings the feet together.
    assert reference[0] > 0.1
    assert np.linalg.norm(com - reference) < 0.01
    assert result.summary["com_error_m"] < 0.012
