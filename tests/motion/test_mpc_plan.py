"""The CoM plan by model predictive control: a pendulum on its support, from rest to rest."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise, permutations, zip_longest

import numpy as np
import pytest

from shared.config.step_settings import WalkConfig
from shared.errors import ConfigError
from shared.motion.com_plan import ComPlan, ZmpSegment
from shared.motion.mpc_plan import (
    JERK_WEIGHT,
    MARGIN,
    VELOCITY_WEIGHT,
    SupportPhase,
    mpc_plan,
)
from shared.motion.walking import Walking

WALKS = {
    "forward": WalkConfig(),
    "paper's double support": WalkConfig(double_support=0.005),
    "long double support": WalkConfig(double_support=0.2),
    "long steps": WalkConfig(step_length=0.15),
    "sideways": WalkConfig(step_length=0.0, step_sideways=0.05, double_support=0.005),
    "turn": WalkConfig(steps=8, step_length=0.0, step_turn=math.radians(13)),
    "curve": WalkConfig(step_length=0.08, step_turn=math.radians(-8)),
    "short beginning": WalkConfig(begin_duration=0.3),
    "one step": WalkConfig(steps=1, step_length=0.05),
}


class Planned:
    """A walk and its two plans."""

    def __init__(self, robot, config):
        walking = Walking(robot, dataclasses.replace(config, com_plan="mpc"))
        self.mpc = walking.com_plan
        self.dcm = Walking(robot, config).com_plan
        self.start = walking.reference(0).com[:2]
        self.phases = walking.support_phases
        self.rest = self.phases[-1].zmp

    def times(self, period):
        return np.arange(0.0, self.mpc.duration, period)


@pytest.fixture(scope="module", params=list(WALKS.values()), ids=list(WALKS))
def planned(request, robot):
    return Planned(robot, request.param)


def outside(points, corners):
    """Largest distance of points (n, 2) from the hull of corners; minus their least depth in it.

    An edge of the hull is a pair of corners with all the others on one side.
    """
    worst = -math.inf
    for a, b in permutations(corners, 2):
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / math.dist(a, b)
        if np.max((corners - a) @ normal) < 1e-9:
            worst = max(worst, np.max((points - a) @ normal))
    return worst


def test_the_zmp_keeps_its_distance_from_the_edge_of_the_support_at_every_instant(planned):
    for phase in planned.phases:
        times = np.linspace(phase.begin, phase.finish - 1e-9, 400)
        zmp = np.array([planned.mpc.state(time).zmp for time in times])
        # The solver takes a row as satisfied to 1e-6.
        assert outside(zmp, phase.corners) < -MARGIN + 2e-6, phase.begin


def test_position_velocity_and_zmp_are_continuous(planned):
    for segment in planned.mpc.segments:
        before, after = (planned.mpc.state(segment.begin + dt) for dt in (-1e-9, 1e-9))
        # Nothing but the ZMP in a short double support is faster than 1 m/s, and that than 100.
        np.testing.assert_allclose(after.position, before.position, atol=2e-9)
        np.testing.assert_allclose(after.velocity, before.velocity, atol=1e-8)
        np.testing.assert_allclose(after.zmp, before.zmp, atol=2e-7)


def test_the_com_obeys_the_pendulum(planned):
    omega, h = planned.mpc.omega, 1e-4
    for segment in planned.mpc.segments:
        time = (segment.begin + segment.finish) / 2
        before, now, after = (planned.mpc.state(time + dt) for dt in (-h, 0.0, h))
        np.testing.assert_allclose(
            now.acceleration, omega**2 * (now.position - now.zmp), rtol=0, atol=1e-12
        )
        # Central differences err by h²/6 of the third derivative: the jerk stays below 1000 m/s³,
        # the snap below ω² times that.
        difference = (after.position - before.position) / (2 * h)
        np.testing.assert_allclose(difference, now.velocity, atol=2e-6)
        difference = (after.velocity - before.velocity) / (2 * h)
        np.testing.assert_allclose(difference, now.acceleration, atol=3e-5)


def test_the_walk_begins_at_rest_over_the_standing_com(planned):
    state = planned.mpc.state(0.0)
    # The velocity comes from the capture point, which the plan runs backwards from the end: zero
    # says that these are the states the horizons were solved from.
    np.testing.assert_allclose(state.position, planned.start, atol=1e-12)
    np.testing.assert_allclose(state.velocity, 0.0, atol=1e-9)
    np.testing.assert_allclose(state.zmp, planned.start, atol=1e-12)


def test_the_walk_ends_at_rest_between_the_feet(planned):
    before = planned.mpc.state(planned.mpc.duration - 1e-9)
    for state in (before, planned.mpc.state(planned.mpc.duration)):
        np.testing.assert_allclose(state.position, planned.rest, atol=1e-8)
        np.testing.assert_allclose(state.velocity, 0.0, atol=1e-7)
        np.testing.assert_allclose(state.zmp, planned.rest, atol=1e-8)


def test_the_walk_is_that_of_the_dcm_plan(planned):
    # A fifth of the sway. The DCM plan begins with the ZMP where it must, even beside the feet.
    for time in planned.times(0.02):
        apart = planned.mpc.state(time).position - planned.dcm.state(time).position
        assert np.linalg.norm(apart) < 0.03, time


def test_the_body_sways_less_as_the_zmp_leaves_the_middle_of_the_sole_a_little(robot):
    walk = Planned(robot, WALKS["paper's double support"])
    swayed = [
        np.ptp([plan.state(time).position[1] for time in np.arange(2.6, 4.2, 0.02)])
        for plan in (walk.mpc, walk.dcm)
    ]
    assert 0.85 * swayed[1] < swayed[0] < 0.98 * swayed[1]
    for phase in walk.phases:
        if len(phase.corners) == 4:
            for time in np.linspace(phase.begin, phase.finish, 100):
                assert math.dist(walk.mpc.state(time).zmp, phase.zmp) < 0.012, time


def test_a_long_walk_neither_diverges_nor_changes_its_steps(robot):
    """e^{ωt} is 10³² after 20 steps: a plan must not carry an error all the way."""
    walk = Planned(robot, WalkConfig(steps=20))
    for plan in (walk.mpc, walk.dcm):
        # The DCM plan has e^{−ω · 1.6 s} of a few centimetres of sway left.
        end = plan.state(plan.duration - 1e-9)
        np.testing.assert_allclose(end.position, walk.rest, atol=1e-4)
        # Two steps later the body is where it was, two step lengths on.
        for time in np.arange(5.0, 13.0, 0.1):
            here, there = plan.state(time).position, plan.state(time + 1.6).position
            # Sample times differ by rounding, and so do the constraints at the end of a horizon.
            np.testing.assert_allclose(there - here, [0.2, 0.0], atol=1e-4)


def test_the_same_walk_is_planned_again_to_the_last_bit(robot):
    one, other = (Planned(robot, WALKS["curve"]) for _ in range(2))
    for a, b in zip(one.mpc.segments, other.mpc.segments, strict=True):
        np.testing.assert_array_equal(a.end, b.end)


def square(x, y, half):
    return np.array([[x + sx * half, y + sy * half] for sx in (-1, 1) for sy in (-1, 1)])


def level(point):
    return np.append(point, 0.0)


def cost_of(zmp, phases, times, *, omega, start):
    """Cost of a walk through the ZMPs at `times`, and how far it is from what it must keep.

    That is rest at `start` and at the end. By the trapezoidal rule, from the plan's own states.
    """
    segments = [
        ZmpSegment(*span, *ends)
        for span, ends in zip(pairwise(times), pairwise(map(level, [start, *zmp])), strict=True)
    ]
    rest = phases[-1].zmp
    plan = ComPlan(segments, omega=omega, position=level(start), capture_point=level(rest))
    origins = [start, *(phase.zmp for phase in phases)]
    cost = 0.0
    for segment, following in zip_longest(segments, segments[1:]):
        k = next(k for k, p in enumerate(phases) if segment.finish < p.finish + 1e-9)
        phase, duration = phases[k], segment.finish - segment.begin
        passed = (segment.finish - phase.begin) / (phase.finish - phase.begin)
        zmp_ref = (1 - passed) * origins[k] + passed * phase.zmp
        velocity = plan.state(segment.finish - 1e-12).velocity
        jerk = omega**2 * (velocity - (segment.end - segment.start)[:2] / duration)
        weight = (duration + (following.finish - following.begin if following else 0.0)) / 2
        cost += duration * JERK_WEIGHT * jerk @ jerk
        cost += weight * VELOCITY_WEIGHT * np.sum((velocity - phase.velocity) ** 2)
        cost += weight * np.sum((segment.end[:2] - zmp_ref) ** 2)
    end = plan.state(plan.duration).position
    return cost, np.concatenate([plan.state(0.0).velocity, end - rest, zmp[-1] - rest])


def test_no_other_zmp_from_rest_to_rest_costs_less():
    """A walk within one horizon and with room on all sides: the cost's slope is zero."""
    floor, omega, start = square(0.0, 0.0, 2.0), 3.8, np.array([0.01, -0.02])
    phases = [
        SupportPhase(0.0, 0.4, floor, np.array([0.0, 0.1]), np.array([0.3, 0.1])),
        SupportPhase(0.4, 0.42, floor, np.array([0.1, -0.1]), np.array([0.2, 0.0])),
        SupportPhase(0.42, 1.0, floor, np.array([0.1, 0.0]), np.array([0.0, 0.0])),
    ]
    plan = mpc_plan(phases, omega=omega, position=start)
    times = [0.0, *(segment.finish for segment in plan.segments)]
    zmp = np.array([segment.end[:2] for segment in plan.segments])

    def evaluate(change):
        return cost_of(zmp + change, phases, times, omega=omega, start=start)

    _, kept = evaluate(np.zeros_like(zmp))
    np.testing.assert_allclose(kept, 0.0, atol=1e-9)
    # All is quadratic or linear in the ZMP, so differences by whole steps are exact.
    units = np.eye(zmp.size).reshape(-1, *zmp.shape)
    sides = [(evaluate(unit), evaluate(-unit)) for unit in units]
    gradient = np.array([(up[0] - down[0]) / 2 for up, down in sides])
    kept_by = np.array([up[1] - kept for up, _ in sides])
    multipliers, *_ = np.linalg.lstsq(kept_by, gradient, rcond=None)
    np.testing.assert_allclose(kept_by @ multipliers, gradient, atol=1e-9)


def test_a_fall_that_no_zmp_prevents_is_refused_with_its_time_and_what_to_try():
    """After standing for 0.1 s, a second on the left foot: the body falls to the right."""
    left, right, zero = square(0.0, 0.1, 0.05), square(0.0, -0.1, 0.05), np.zeros(2)
    both, centre = np.vstack([left, right]), np.zeros(2)
    phases = [
        SupportPhase(0.0, 0.1, both, left.mean(axis=0), zero),
        SupportPhase(0.1, 1.1, left, left.mean(axis=0), zero),
        SupportPhase(1.1, 3.0, both, centre, zero),
    ]
    with pytest.raises(ConfigError, match=r"from 0\.00 s on .* begin_duration .* com_plan"):
        mpc_plan(phases, omega=3.8, position=centre)


def test_standing_is_a_plan_that_does_not_move():
    corners, zero = np.vstack([square(0.0, 0.1, 0.05), square(0.0, -0.1, 0.05)]), np.zeros(2)
    plan = mpc_plan([SupportPhase(0.0, 3.0, corners, zero, zero)], omega=3.8, position=zero)
    for time in (0.0, 1.23, 3.0, 5.0):
        np.testing.assert_allclose(plan.state(time).position, zero, atol=1e-12)
