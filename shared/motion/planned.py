"""A plan: a motion as data, from the present contact phase to a stand.

A phase has one contact mode. In it the centre of pressure (CoP) p stays, and the divergent
component of motion (DCM) ξ = c + ċ/ω leaves it,

    ξ(t) = p + (ξ_end − p) e^{ω (t − t_end)},

as the linear inverted pendulum does. The last phase is a stand: a plan is always complete, so the
link may die after any message. `PlannedMotion` plays a plan by the clock. The robot advances its
phases by time and by touch (`robot_node/stepping.py`).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.motion.com_plan import ComPlan, ZmpSegment
from shared.motion.footprint import Footprint
from shared.motion.stance import Stance
from shared.motion.standing import Standing
from shared.motion.swing import swing
from shared.robots import Foot, Robot
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Motion, Reference, motion_digest, turned

SUPPORT_MODE = {Foot.LEFT: ContactMode.RIGHT_SUPPORT, Foot.RIGHT: ContactMode.LEFT_SUPPORT}
"""The contact mode while a foot is in the air."""


@dataclass(frozen=True, slots=True)
class PlannedPhase:
    """A span of one contact mode, with its expected beginning and end after the plan's beginning
    [ns].

    `footprint` is the footprint in which the swing foot lands, None on both feet. `cop` and `dcm`
    (the latter at the end) are positions in the plane [m].
    """

    mode: ContactMode
    begin_ns: int
    end_ns: int
    footprint: Footprint | None
    cop: tuple[float, float]
    dcm: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PlanOrigin:
    """The state from which a plan was made: its session and sequence, and the phase of the robot.

    The robot counts its phases from 0. The first phase of the plan is this one.
    """

    session: int
    sequence: int
    phase: int


@dataclass(frozen=True)
class Plan:
    """A motion to a stand.

    `number` grows from plan to plan. `feet` are the soles at its beginning, left and right; a swing
    foot has the footprint from which it lifted. `com` is the CoM in the plane at its beginning [m].
    `swing_height` is the height above the higher footprint of a step [m]. A plan that has not begun
    by `valid_until_ns` of the robot's clock is void.
    """

    number: int
    origin: PlanOrigin
    valid_until_ns: int
    feet: tuple[Footprint, Footprint]
    com: tuple[float, float]
    phases: tuple[PlannedPhase, ...]
    swing_height: float

    def footprints(self) -> tuple[Footprint, ...]:
        """Return the footprints of the landings, in the order of time."""
        return tuple(each.footprint for each in self.phases if each.footprint is not None)


class PlannedMotion:
    """A plan by the clock, as a `Motion`."""

    def __init__(self, plan: Plan, robot: Robot) -> None:
        self.plan = plan
        self._standing = Standing(robot).reference(0)
        height = float(self._standing.com[2])
        self._omega = Stance.of(robot).omega
        self._height = height
        self._ends = [phase.end_ns for phase in plan.phases]
        segments = [
            ZmpSegment(
                phase.begin_ns * 1e-9, phase.end_ns * 1e-9, _level(phase.cop), _level(phase.cop)
            )
            for phase in plan.phases
        ]
        self._com = ComPlan(
            segments,
            omega=self._omega,
            position=_level(plan.com),
            capture_point=_level(plan.phases[-1].dcm),
        )
        self._feet = list(_feet_by_phase(plan))
        self.digest = motion_digest(
            np.array([[each.x, each.y, each.yaw] for each in plan.footprints()]),
            np.array([[phase.end_ns * 1e-9, phase.mode] for phase in plan.phases]),
        )

    def reference(self, time_ns: int) -> Reference:
        """Reference at a time since the plan began; standing after its end."""
        k = min(bisect.bisect_right(self._ends, max(0, time_ns)), len(self._ends) - 1)
        phase, feet = self.plan.phases[k], self._feet[k]
        com, velocity, acceleration = self._com.motion(time_ns * 1e-9)
        state, yaw = None, _mean_yaw(feet)
        if phase.footprint is not None:
            start = feet[phase.footprint.foot]
            duration = (phase.end_ns - phase.begin_ns) * 1e-9
            state = swing(
                start,
                phase.footprint,
                time=max(0.0, (time_ns - phase.begin_ns) * 1e-9),
                duration=duration,
                height=self.plan.swing_height,
            )
            support = feet[other(phase.footprint.foot)]
            yaw = support.yaw + 0.5 * math.remainder(state.yaw - support.yaw, math.tau)
        return Reference(
            com=com + np.array((0.0, 0.0, self._standing.com[2] - com[2])),
            com_velocity=velocity,
            com_acceleration=acceleration,
            world_from_base=turned(yaw) @ self._standing.world_from_base,
            posture=self._standing.posture,
            mode=phase.mode,
            swing=state,
        )

    def next_switch(self, time_ns: int) -> int | None:
        k = bisect.bisect_right(self._ends, time_ns)
        return self._ends[k] if k + 1 < len(self._ends) else None

    def stopped(self, time_ns: int) -> Motion:
        """Return itself: every plan ends in a stand."""
        return self


def _level(point: tuple[float, float]) -> np.ndarray:
    """A point of the ground, (3,)."""
    return np.array((*point, 0.0))


def other(foot: Foot) -> Foot:
    """Return the other foot."""
    return Foot.RIGHT if foot is Foot.LEFT else Foot.LEFT


def _mean_yaw(feet: dict[Foot, Footprint]) -> float:
    left, right = feet[Foot.LEFT].yaw, feet[Foot.RIGHT].yaw
    return left + 0.5 * math.remainder(right - left, math.tau)


def _feet_by_phase(plan: Plan) -> Sequence[dict[Foot, Footprint]]:
    """The soles at the beginning of each phase."""
    feet = {each.foot: each for each in plan.feet}
    by_phase = []
    for phase in plan.phases:
        by_phase.append(dict(feet))
        if phase.footprint is not None:
            feet[phase.footprint.foot] = phase.footprint
    return by_phase
