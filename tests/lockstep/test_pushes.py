"""Pushes that the robot stands because its QP knows its limits, and the measured forces."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from experiments.lockstep import Lockstep
from shared.config.config_file import load_config

ITS_LIMITS = {
    "plant.joint_limits": True,
    "plant.leg_collision": True,
    "wbc.limits.torque": True,
    "wbc.limits.position": True,
    "wbc.balance.law": "dcm",
    "wbc.weights.com": 10.0,
}


def play(**settings):
    config = load_config(None, {"view": "off", **settings})
    return Lockstep(config, all_active_sets=False).run()


@pytest.mark.parametrize("controller", ["lc", "la", "pr"])
def test_with_its_limits_the_robot_stands_a_push_forward(controller):
    """100 N for 0.2 s, from which the default settings do not recover."""
    settings = {
        "push": ["100N@0.2s:0.2s:+x"],
        "controller": controller,
        "link.network": "constant:0ms",
    }
    result = play(**settings, **ITS_LIMITS, duration=1.5)
    assert not result.summary["fell"]
    assert result.summary["saturated_ticks"] == 0
    assert result.summary["joint_beyond_rad"] < 0.0
    # At rest again, over its feet.
    assert np.abs(result.schema.column(result.rows, "com")[-1] - [0.03, 0.0, 0.66]).max() < 0.05


def test_with_its_limits_lc_stands_a_diagonal_push_on_a_dead_link():
    result = play(
        **ITS_LIMITS,
        **{
            "push": ["130N@0.2s:0.2s:+x-y"],
            "controller": "lc",
            "link.network": "constant:10ms",
            "link.outage": ["cut@50ms"],
            "duration": 1.5,
        },
    )
    assert not result.summary["fell"]
    assert result.summary["saturated_ticks"] == 0


def test_limits_of_an_old_state_do_not_throw_the_joints_of_la():
    """LA over 50 ms: joints on their limits at the edge's state, and others by now."""
    settings = {
        "push": ["80N@0.1s:0.2s:+y"],
        "controller": "la",
        "link.network": "constant:50ms",
        "duration": 0.9,
    }
    result = play(**settings, **ITS_LIMITS)
    assert not result.summary["fell"]
    assert result.summary["saturated_ticks"] == 0
    assert result.summary["joint_beyond_rad"] < 0.0


@pytest.mark.parametrize("controller", ["pr", "la", "lc"])
def test_a_weight_of_the_angular_momentum_turns_the_robot_less(controller, robot):
    def turning(weight):
        settings = {
            "controller": controller,
            "push": ["80N@0.05s:0.1s:+y"],
            "link.network": "constant:5ms",
            "duration": 0.4,
            "sensors.joint_position_noise": 0.0,
            "wbc.weights.angular_momentum": weight,
            "wbc.gains.angular_momentum": 50.0,
        }
        result = play(**settings)
        assert not result.summary["fell"]
        data = robot.model.createData()
        states = zip(
            result.schema.column(result.rows, "q"),
            result.schema.column(result.rows, "v"),
            strict=True,
        )
        # After the push, which turns the robot with either weight.
        momenta = [
            pin.computeCentroidalMomentum(robot.model, data, q, v).angular.copy()
            for q, v in list(states)[150:]
        ]
        return np.sqrt(np.mean(np.square(momenta)))

    assert turning(1.0) < 0.5 * turning(0.0)


def test_with_a_task_of_the_cop_the_controllers_agree():
    """Under a push, without delay: PR and LA to the last bit, LC but for its stale trade-off."""
    pr, la, lc = (
        play(
            **{
                "controller": controller,
                "push": ["60N@0.05s:0.1s:+x"],
                "link.network": "constant:0ms",
                "duration": 0.3,
                "wbc.weights.cop": 1.0,
            }
        )
        for controller in ("pr", "la", "lc")
    )
    np.testing.assert_array_equal(
        pr.schema.column(pr.rows, "tau"), la.schema.column(la.rows, "tau")
    )
    com = lc.schema.column(lc.rows, "com")
    assert np.abs(com - la.schema.column(la.rows, "com")).max() < 3e-4


@pytest.mark.parametrize("kind", ["mujoco", "rigid"])
def test_the_measured_forces_carry_the_robot(kind, robot):
    result = play(
        **{
            "plant.kind": kind,
            "push": [],
            "duration": 0.3,
            "sensors.measure_forces": True,
            "link.network": "constant:0ms",
        }
    )
    forces = result.schema.column(result.rows, "contact_force_n")[-50:].mean(axis=0)
    assert forces[2] + forces[5] == pytest.approx(9.81 * robot.mass, rel=0.02)
    assert min(forces[2], forces[5]) > 0.4 * 9.81 * robot.mass
    assert np.abs(forces[[0, 3]]).max() < 30.0


def test_forces_are_not_measured_by_default():
    result = play(push=[], duration=0.05)
    assert np.isnan(result.schema.column(result.rows, "contact_force_n")).all()
