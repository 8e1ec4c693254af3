"""A walk that is ended early: the step under way, one more, and a stand, without a jump."""

from __future__ import annotations

import numpy as np
import pytest

from shared.config.step_settings import WalkConfig
from shared.motion.cross_fade import DURATION
from shared.motion.standing import Standing
from shared.motion.walking import Walking
from shared.wbc.contacts import ContactMode

MS = 1_000_000


@pytest.fixture(scope="module")
def walking(robot):
    return Walking(robot, WalkConfig(steps=8))


@pytest.mark.parametrize("time_ms", [0, 900, 1000, 1400, 1779, 1780, 1799, 2000, 3333])
def test_until_then_it_is_the_same_and_after_two_steps_it_stands(walking, time_ms):
    stopped = walking.stopped(time_ms * MS)
    for at in range(0, time_ms, 50):
        before, after = walking.reference(at * MS), stopped.reference(at * MS)
        np.testing.assert_array_equal(before.com, after.com)
        assert before.mode is after.mode
    switches = []
    at = time_ms * MS
    while (switch_ns := stopped.next_switch(at)) is not None:
        switches.append(switch_ns)
        at = switch_ns
    # At most the step under way and another: two switches each, and the one that begins a step.
    assert len(switches) <= 5
    end = stopped.reference(at + 3_000 * MS)
    assert end.mode is ContactMode.DOUBLE_SUPPORT
    np.testing.assert_allclose(end.com_velocity, 0.0, atol=1e-9)
    assert end.com[0] < walking.reference(10_000 * MS).com[0]


@pytest.mark.parametrize("time_ms", [500, 1400, 1790, 2600])
def test_the_reference_of_the_centre_of_mass_does_not_jump(walking, time_ms):
    stopped = walking.stopped(time_ms * MS)
    times = np.arange(time_ms - 5, time_ms + 1000 * DURATION + 5)
    com = np.array([stopped.reference(int(t * MS)).com for t in times])
    velocity = np.array([stopped.reference(int(t * MS)).com_velocity for t in times])
    steps = np.diff(com, axis=0) * 1e3
    # What a millisecond moves is what the velocities at its two ends say.
    np.testing.assert_allclose(steps, (velocity[1:] + velocity[:-1]) / 2, atol=2e-4)
    assert np.abs(np.diff(velocity, axis=0)).max() < 8e-3


def test_in_its_last_steps_a_walk_is_not_shortened(walking):
    late = walking.phases[-3].begin_ns
    assert walking.stopped(late) is walking


def test_standing_stays_standing(robot):
    standing = Standing(robot)
    assert standing.stopped(0) is standing
