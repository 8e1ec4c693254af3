"""The ghost: a posture that has the CoM, the base and the soles of the plan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from shared.config.settings import RunConfig
from shared.motion.plan import make_motion
from shared.motion.standing import Standing
from shared.motion.walking import Walking
from shared.robots import Foot, Robot
from shared.wbc.model import WholeBodyModel
from viewer.ghost import Ghost

FRAME_NS = 20_000_000
# The ghost stops at a tenth of a millimetre before its last step, which is quadratically better.
NEAR = 1e-5


@pytest.fixture
def walk(robot: Robot, configured: Callable[..., RunConfig]) -> Walking:
    motion = make_motion(
        robot, configured(**{"task": "walk", "wire.projector_dtype": "float32", "walk.steps": 3})
    )
    assert isinstance(motion, Walking)
    return motion


def com_of(robot: Robot, q: np.ndarray) -> np.ndarray:
    return WholeBodyModel(robot).kinematics(q, np.zeros(robot.model.nv)).com


def test_the_ghost_of_a_stand_is_the_standing_configuration(robot: Robot) -> None:
    ghost = Ghost(robot, Standing(robot))
    for time_ns in (-1, 0, 3_000_000_000):
        np.testing.assert_allclose(ghost.posture(time_ns), robot.q_standing, atol=1e-6)


def test_the_ghost_of_a_walk_has_its_com_base_and_feet_in_the_air_and_on_the_ground(
    robot: Robot, walk: Walking
) -> None:
    ghost, model = Ghost(robot, walk), WholeBodyModel(robot)
    for time_ns in range(0, walk.phases[-1].end_ns, FRAME_NS):
        q = ghost.posture(time_ns).copy()
        reference = walk.reference(time_ns)
        np.testing.assert_allclose(com_of(robot, q), reference.com, atol=NEAR)
        turned = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()
        np.testing.assert_allclose(turned, reference.world_from_base, atol=NEAR)
        soles = model.sole_placements(q)
        for foot in reference.mode.feet:
            assert abs(soles[foot].translation[2]) < NEAR
        if reference.swing is not None:
            (foot,) = (foot for foot in Foot if foot not in reference.mode.feet)
            np.testing.assert_allclose(soles[foot].translation, reference.swing.position, atol=NEAR)
    last = walk.steps[-1].goal
    np.testing.assert_allclose(soles[last.foot].translation[:2], last.position, atol=NEAR)


def test_a_ghost_that_begins_in_the_middle_is_where_one_from_the_start_is(
    robot: Robot, walk: Walking
) -> None:
    late, early = Ghost(robot, walk), Ghost(robot, walk)
    time_ns = 2_500_000_000
    for before in range(0, time_ns, FRAME_NS):
        early.posture(before)
    # Near the posture up to what its null space leaves open.
    np.testing.assert_allclose(late.posture(time_ns), early.posture(time_ns), atol=1e-2)


def test_the_ghost_ends_a_walk_as_early_as_the_robot_does(
    robot: Robot, configured: Callable[..., RunConfig]
) -> None:
    config = configured(**{"task": "walk", "wire.projector_dtype": "float32", "walk.steps": 8})
    motion = make_motion(robot, config)
    ghost, stop_ns = Ghost(robot, motion), 2_000_000_000
    stopped = motion.stopped(stop_ns)
    for time_ns in range(0, 6_000_000_000, FRAME_NS):
        if time_ns >= stop_ns:
            ghost.stop(time_ns)
        q = ghost.posture(time_ns).copy()
    np.testing.assert_allclose(com_of(robot, q), stopped.reference(6_000_000_000).com, atol=NEAR)
    soles = WholeBodyModel(robot).sole_placements(q)
    apart = soles[Foot.LEFT].translation - soles[Foot.RIGHT].translation
    assert abs(apart[0]) < 1e-3, "the last step brings the feet together"
    assert max(abs(sole.translation[2]) for sole in soles.values()) < NEAR
