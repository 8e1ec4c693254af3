"""Plans of footsteps: from an advance for each step to footprints, and to the phases of a plan."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from shared.config.settings import RunConfig
from shared.motion.footprint import Footprint
from shared.motion.pendulum import dcm_of, moved_dcm
from shared.motion.planned import SUPPORT_MODE, Plan, PlannedPhase, PlanOrigin, other
from shared.motion.stance import Stance, lower_foot, middle
from shared.robots import Foot, Robot
from shared.wbc.contacts import ContactMode
from shared.wire.messages import RobotState, StepReport

# Steps of one plan at most, before it comes to a stand.
MAX_STEPS = 8
# A plan is valid for this time after its state [ns].
_VALID_NS = 1_000_000_000
# A robot on both feet for longer than between two steps stands [s].
_STANDS = 0.2
# The CoP of a weight shift is at most as far from the DCM [m].
_FARTHEST_COP = 0.3


class FootstepBuilder:
    """Puts footprints into a plan, with the CoP and DCM of each phase."""

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self.stance = Stance.of(robot, lowering=config.walk.com_lowering)
        self._config = config.walk
        self._double_support = config.stepping.double_support
        self._swing_height = config.stepping.swing_height

    def steps(
        self,
        state: RobotState,
        advance: tuple[float, float, float],
        *,
        com: np.ndarray,
        number: int,
        steps: int,
        width: float | None = None,
    ) -> Plan:
        """Return the plan of `steps` from a state with a report on, each of `advance`.

        `com` is as for a `Planner`. `width` is that of the walk, if it is not given.
        """
        assert state.steps is not None
        footprints = footsteps(
            state.steps,
            state.mode,
            advance,
            dcm=dcm_of(*com, omega=self.stance.omega),
            steps=steps,
            width=width or self._config.step_width or self.stance.width,
        )
        return self._plan(state, state.steps, footprints, com=com, number=number)

    def along(
        self,
        state: RobotState,
        footprints: list[Footprint],
        *,
        com: np.ndarray,
        number: int,
        swing_height: float,
    ) -> Plan:
        """Return the plan over given footprints from a state with a report on.

        `com` is as for a `Planner`, `swing_height` is over the higher footprint of a step [m].
        """
        assert state.steps is not None
        plan = self._plan(state, state.steps, footprints, com=com, number=number)
        return dataclasses.replace(plan, swing_height=swing_height)

    def _plan(
        self,
        state: RobotState,
        report: StepReport,
        footprints: list[Footprint],
        *,
        com: np.ndarray,
        number: int,
    ) -> Plan:
        """Return the plan that puts the feet down on `footprints`, one after the other.

        If a foot is in the air, the first one is where it lands.
        """
        omega, config, mode = self.stance.omega, self._config, state.mode
        single = config.step_duration - self._double_support
        feet = {each.foot: each for each in report.feet}
        elapsed = report.phase_ns * 1e-9
        # (mode, duration, footprint, CoP)
        spans: list[tuple[ContactMode, float, Footprint | None, np.ndarray | None]] = []
        if mode is ContactMode.DOUBLE_SUPPORT:
            # A robot that stands has to shift its weight first.
            stands = report.phase == 0 or elapsed > _STANDS
            shift = elapsed + config.begin_duration if stands else self._double_support
            spans.append((mode, max(shift, elapsed + 0.02), None, None))
        for goal in footprints:
            support = feet[other(goal.foot)]
            duration = single
            if not spans:
                duration = max(single, elapsed + 0.1)
            cop = support.to_world(self.stance.cop_in_sole)
            spans.append((SUPPORT_MODE[goal.foot], duration, goal, cop))
            feet[goal.foot] = goal
            following = feet[goal.foot].to_world(self.stance.cop_in_sole)
            spans.append(
                (ContactMode.DOUBLE_SUPPORT, self._double_support, None, (cop + following) / 2)
            )
        rest = self.stance.rest_over(feet)
        spans[-1] = (ContactMode.DOUBLE_SUPPORT, config.end_duration, None, rest)
        # Backwards from rest: the DCM at the end of each phase.
        ends = [rest]
        for _, duration, _, cop in reversed(spans[1:]):
            assert cop is not None
            ends.append(moved_dcm(ends[-1], cop=cop, growth=math.exp(-omega * duration)))
        ends.reverse()
        if spans[0][3] is None:
            # The one CoP that brings the DCM from where it is to where the first step wants it.
            mode, duration, goal_, _ = spans[0]
            left = max(0.02, duration - elapsed)
            growth = math.exp(omega * left)
            dcm = dcm_of(*com, omega=omega)
            shift = (dcm - ends[0]) / (growth - 1.0)
            # With little time left no real CoP suffices, and the step law corrects the step.
            shift *= min(1.0, _FARTHEST_COP / max(1e-9, math.hypot(*shift.tolist())))
            spans[0] = (mode, duration, goal_, dcm + shift)
        phases, begin_ns = [], 0
        for (mode, duration, goal_, at), dcm in zip(spans, ends, strict=True):
            assert at is not None
            end_ns = begin_ns + round(duration * 1e9)
            points = (float(at[0]), float(at[1])), (float(dcm[0]), float(dcm[1]))
            phases.append(PlannedPhase(mode, begin_ns, end_ns, goal_, *points))
            begin_ns = end_ns
        return plan_from(
            state, report, phases, com=com, number=number, swing_height=self._swing_height
        )


def plan_from(
    state: RobotState,
    report: StepReport,
    phases: list[PlannedPhase],
    *,
    com: np.ndarray,
    number: int,
    swing_height: float,
) -> Plan:
    """Return the plan of `phases`, the first of which is the one that the state reports.

    `com` is as for a `Planner`.
    """
    return Plan(
        number=number,
        origin=PlanOrigin(state.session, state.sequence, report.phase),
        valid_until_ns=state.stamp_ns + _VALID_NS,
        feet=report.feet,
        com=(float(com[0, 0]), float(com[0, 1])),
        phases=tuple(phases),
        swing_height=swing_height,
    )


def foot_to_lift(report: StepReport, dcm: np.ndarray) -> Foot | None:
    """Return the foot that the DCM (2,) of a robot leaves that has just landed.

    The DCM is then on its way to the next support foot, and has no time to turn back. None if the
    robot stands and may lift either foot.
    """
    if report.phase == 0 or report.phase_ns * 1e-9 >= _STANDS:
        return None
    return max(report.feet, key=lambda each: math.dist(dcm, (each.x, each.y))).foot


def footsteps(
    report: StepReport,
    mode: ContactMode,
    advance: tuple[float, float, float],
    *,
    dcm: np.ndarray,
    steps: int,
    width: float,
) -> list[Footprint]:
    """Footprints of steps that advance by (length, sideways, turn) each, from a robot's feet on.

    The last one brings the feet together. `dcm` (2,) is the robot's DCM. A robot that has not moved
    leads with the foot on the side that the path goes to.
    """
    feet = {each.foot: each for each in report.feet}
    leaves = foot_to_lift(report, dcm)
    if mode is not ContactMode.DOUBLE_SUPPORT:
        swing = next(each for each, during in SUPPORT_MODE.items() if during is mode)
    elif report.phase == 0:
        swing = Foot.RIGHT if (advance[1] or advance[2]) < 0 else Foot.LEFT
    elif leaves is not None:
        swing = leaves
    else:
        # The foot that is behind on the path.
        x, y, yaw = middle(feet)
        behind = {
            foot: math.cos(yaw) * (each.x - x) + math.sin(yaw) * (each.y - y)
            for foot, each in feet.items()
        }
        swing = min(behind, key=lambda foot: behind[foot])
    height = lower_foot(feet).z
    made = []
    for k in range(steps):
        support = feet[other(swing)]
        side = 0.5 * width if swing is Foot.LEFT else -0.5 * width
        # The path goes through the middle: half a width beside the support foot.
        yaw = support.yaw
        x = support.x - math.sin(yaw) * side
        y = support.y + math.cos(yaw) * side
        if k < steps - 1:
            c, s = math.cos(yaw), math.sin(yaw)
            x += c * advance[0] - s * advance[1]
            y += s * advance[0] + c * advance[1]
            yaw += advance[2]
        place = x - math.sin(yaw) * side, y + math.cos(yaw) * side
        goal = Footprint(swing, *place, yaw, height)
        made.append(goal)
        feet[swing] = goal
        swing = other(swing)
    return made
