"""Where a step that the law decides on lands on a ground that the robot knows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shared.motion.footprint import Footprint
from shared.motion.ground import FLAT, make_ground
from shared.motion.step_decision import Balance, InAir, Step, StepDecision
from shared.motion.step_law import make_step_law
from shared.robots import Foot

STANDS, PLANNED = 0.9, 1.15


def step_on(robot, config, *, dcm_ahead: float) -> Step:
    """The step of the right foot from a stance on the ground."""
    decision = StepDecision(robot, config)
    heights = make_ground(config.ground, seed=config.seed)
    law = make_step_law(robot, decision.stance, FLAT)
    feet = {
        foot: Footprint(foot, STANDS, y, 0.0, heights.height(STANDS, y))
        for foot, y in ((Foot.LEFT, 0.096), (Foot.RIGHT, -0.096))
    }
    nominal = Footprint(Foot.RIGHT, PLANNED, -0.096, 0.0, heights.height(PLANNED, -0.096))
    dcm = decision.stance.rest_over(feet) + np.array((dcm_ahead, 0.0))
    balance = Balance(feet, dcm, np.zeros(2))
    step = decision.step(law, balance, InAir.at_rest(feet[Foot.RIGHT], nominal, 0.4))
    assert step is not None
    return step


@pytest.mark.parametrize("dcm_ahead", [0.0, 0.2])
@pytest.mark.parametrize("degrees", [8.0, -8.0])
def test_a_moved_foothold_is_as_high_as_the_ground_there(robot, configured, degrees, dcm_ahead):
    config = configured(**{"task": "go", "stepping.mode": "on", "ground": f"slope:{degrees:g}deg"})
    step = step_on(robot, config, dcm_ahead=dcm_ahead)
    sole, rise = step.footprint, math.tan(math.radians(degrees))
    assert abs(sole.x - PLANNED) > 0.03
    # The slope begins 0.2 m ahead of the origin. Downhill the heel comes first.
    heel = robot.soles[1].corners()[:, 0].min()
    assert sole.z == pytest.approx(rise * (sole.x - 0.2) + max(0.0, rise * heel), abs=1e-9)


def test_a_moved_foothold_keeps_the_height_of_a_flat_ground(robot, configured):
    assert step_on(robot, configured(**{"stepping.mode": "on"}), dcm_ahead=0.2).footprint.z == 0.0
