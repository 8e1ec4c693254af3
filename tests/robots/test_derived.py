"""The rule from mass and geometry to settings, and the robots whose files follow it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.robots import Foot, load_robot
from shared.robots.derived import derived_settings
from shared.robots.standing import REACH_MARGIN, leg_length
from tests.processes import ROOT

# The files say why.
DIFFERENT = {("icub", "balance", "push"), ("g1", "walk", "walk.step_length")}
UNTUNED = str(ROOT / "examples" / "alexander.toml")

# Settings of a robot that are no part of the rule: docs/own-robot.md.
BESIDE = {"g1": {"loop.hold_after"}, "icub": {"loop.hold_after"}}


def stated(table, where=""):
    """The settings of a table by dotted key."""
    flat: dict[str, object] = {}
    for key, value in table.items():
        dotted = f"{where}{key}"
        flat |= stated(value, f"{dotted}.") if isinstance(value, dict) else {dotted: value}
    return flat


@pytest.mark.parametrize("name", ["g1", "icub", UNTUNED])
def test_the_file_of_a_robot_has_the_settings_of_the_rule(name):
    robot = load_robot(name)
    for task, expected in derived_settings(robot).items():
        found = stated(robot.description.settings[task])
        assert found.keys() == expected.keys() | BESIDE.get(name, set())
        for key, value in expected.items():
            if (name, task, key) not in DIFFERENT:
                assert found[key] == value


def test_the_rule_gives_the_default_robot_about_its_own_settings(robot):
    settings, default = derived_settings(robot), RunConfig()
    assert settings["balance"]["push"] == ["102N@1.0s:0.2s:+y"]  # 100 N
    assert settings["balance"]["wbc.weights.force"] == default.wbc.weights.force
    assert settings["walk"]["walk.step_length"] == pytest.approx(
        default.walk.step_length, abs=0.011
    )
    assert settings["walk"]["walk.step_duration"] == pytest.approx(
        default.walk.step_duration, abs=0.02
    )


@pytest.mark.parametrize("task", ["balance", "walk"])
def test_the_settings_of_the_rule_are_settings_of_a_run(robot, task):
    assert load_config(None, {"task": task, **derived_settings(robot)[task]}).task == task


@pytest.mark.parametrize(
    ("name", "knee"),
    [("romeo", "LKneePitch"), ("g1", "left_knee_joint"), (UNTUNED, "LEFT_KNEE_Y")],
)
def test_a_leg_is_as_long_as_its_knee_stretches_it(name, knee):
    # The hip's joints of the second and third robot are apart, which makes no leg longer.
    robot = load_robot(name)
    model, data, q = robot.model, robot.model.createData(), robot.q_standing.copy()
    ankle = robot.sole_frame(Foot.LEFT).parentJoint
    hip = next(joint for joint in model.supports[ankle] if joint > 1)
    lengths = []
    for angle in np.linspace(-0.5, 0.5, 2001):
        q[model.joints[model.getJointId(knee)].idx_q] = angle
        pin.forwardKinematics(model, data, q)
        lengths.append(np.linalg.norm(data.oMi[hip].translation - data.oMi[ankle].translation))
    assert leg_length(robot)[0] == pytest.approx(REACH_MARGIN * max(lengths), abs=1e-5)
