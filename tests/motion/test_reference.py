from __future__ import annotations

import numpy as np

from shared.motion.standing import Standing
from shared.wbc.contacts import ContactMode


def test_standing_is_where_the_robot_stands_for_ever(robot, model, motion):
    kinematics = model.kinematics(robot.q_standing, np.zeros(model.nv))
    for time_ns in (0, 1, 10**9, 10**15):
        reference = motion.reference(time_ns)
        np.testing.assert_allclose(reference.com, kinematics.com, atol=1e-14)
        np.testing.assert_allclose(reference.world_from_base, kinematics.world_from_base)
        np.testing.assert_array_equal(reference.posture, robot.q_standing[7:])
        np.testing.assert_array_equal(reference.com_velocity, 0.0)
        np.testing.assert_array_equal(reference.com_acceleration, 0.0)
        assert reference.mode is ContactMode.DOUBLE_SUPPORT


def test_both_ends_derive_the_same_reference(robot, motion):
    other = Standing(robot)
    np.testing.assert_array_equal(other.reference(0).com, motion.reference(0).com)
