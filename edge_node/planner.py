"""The edge's planners: where the robot goes, as footsteps to a stand.

A planner gets a state with the robot's own phase. It returns a complete plan from that phase on, or
None if the robot shall stand. The robot's step law moves the footsteps when necessary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from edge_node.footstep_plan import MAX_STEPS, FootstepBuilder, plan_from
from edge_node.ground_planner import GroundPlanner
from shared.config.quantities import parse_ground
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.motion.pendulum import dcm_of
from shared.motion.planned import SUPPORT_MODE, Plan, PlannedPhase
from shared.motion.stance import middle
from shared.motion.step_decision import Balance, InAir, StepDecision
from shared.motion.step_law import StepLaw
from shared.robots import Robot
from shared.wbc.contacts import ContactMode
from shared.wire.messages import RobotState, StepReport
from shared.wire.operator.commands import DRIVE_NS, EdgeCommand, Go

# The time from the last step until the feet come together [ns], and the distance within which they
# are together [m].
_BEFORE_TOGETHER_NS, _TOGETHER = 1_000_000_000, 0.06
# Steps of a plan towards a velocity, before its stand.
_VELOCITY_STEPS = 4
# The most that a step advances: forward and sideways [m], turning [rad].
_MOST = (0.15, 0.06, math.radians(15.0))
# A robot this near to its goal has arrived [m, rad].
_AT_GOAL, _TURNED_TO_GOAL = 0.03, math.radians(4.0)


@dataclass(frozen=True)
class Velocity:
    """Velocity of the path: forward and to the left [m/s], and turning to the left [rad/s]."""

    forward: float = 0.0
    left: float = 0.0
    turning: float = 0.0


class Planner(Protocol):
    """The footsteps of a robot.

    The edge asks it until it has a plan for the present phase, and a planner that `reacts` also
    after that.
    """

    reacts: bool

    def plan(self, state: RobotState, *, com: np.ndarray, number: int) -> Plan | None:
        """Return the plan from the phase of a state on, or None for a stand.

        `com` (2, 2) is the CoM in the plane and its velocity at that state.
        """
        ...


class StandingPlanner:
    """The robot stands, and steps only if its step law says so.

    After such steps, when it has stood for a while, two more bring its feet together.
    """

    reacts = False

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self._build = FootstepBuilder(robot, config)

    def plan(self, state: RobotState, *, com: np.ndarray, number: int) -> Plan | None:
        report = state.steps
        if report is None or state.mode is not ContactMode.DOUBLE_SUPPORT:
            return None
        if report.phase_ns < _BEFORE_TOGETHER_NS or self._together(report):
            return None
        return self._build.steps(
            state,
            (0.0, 0.0, 0.0),
            com=com,
            number=number,
            steps=2,
            width=self._build.stance.width,
        )

    def _together(self, report: StepReport) -> bool:
        left, right = report.feet
        c, s = math.cos(right.yaw), math.sin(right.yaw)
        dx, dy = left.x - right.x, left.y - right.y
        ahead, beside = c * dx + s * dy, -s * dx + c * dy
        return math.hypot(ahead, beside - self._build.stance.width) < _TOGETHER


class ReactivePlanner:
    """Steps of a standing robot that must step, decided on the edge alone: for comparison.

    The decision is that of the robot's step law, at a state that is as old as the link is slow.
    """

    reacts = True

    def __init__(self, robot: Robot, config: RunConfig, law: StepLaw) -> None:
        self._law = law
        self._decision = StepDecision(robot, config)
        self._double_support_ns = round(config.stepping.double_support * 1e9)
        self._end_ns = round(config.walk.end_duration * 1e9)
        self._swing_height = config.stepping.swing_height

    def plan(self, state: RobotState, *, com: np.ndarray, number: int) -> Plan | None:
        report = state.steps
        if report is None:
            return None
        feet = {each.foot: each for each in report.feet}
        dcm = dcm_of(*com, omega=self._decision.stance.omega)
        balance = Balance(feet, dcm, report.disturbance)
        phases: list[PlannedPhase] = []
        begin_ns = 0
        if state.mode is ContactMode.DOUBLE_SUPPORT:
            waits = report.phase > 0 and report.phase_ns < self._double_support_ns
            if waits or not self._decision.must_step(balance):
                return None
            step = self._decision.best_step(self._law, balance)
            begin_ns = report.phase_ns + 1_000_000
            point = (float(dcm[0]), float(dcm[1]))
            phases.append(PlannedPhase(state.mode, 0, begin_ns, None, point, point))
        else:
            if report.swing is None:
                return None
            swing = report.swing
            motion = np.array((swing.position[:2], swing.velocity[:2], swing.acceleration[:2]))
            foot = next(each for each, during in SUPPORT_MODE.items() if during is state.mode)
            in_air = InAir(foot, motion, report.phase_ns * 1e-9)
            step = self._decision.step(self._law, balance, in_air)
        if step is None:
            return None
        goal = step.footprint
        elapsed_ns = 0 if phases else report.phase_ns
        end_ns = begin_ns + elapsed_ns + round(step.remaining * 1e9)
        cop, at_end = (tuple(each.tolist()) for each in (step.cop, step.dcm))
        mode = SUPPORT_MODE[goal.foot]
        phases.append(PlannedPhase(mode, begin_ns, end_ns, goal, cop, at_end))
        feet[goal.foot] = goal
        rest = self._decision.stance.rest_over(feet)
        stand = (float(rest[0]), float(rest[1]))
        both = ContactMode.DOUBLE_SUPPORT
        phases.append(PlannedPhase(both, end_ns, end_ns + self._end_ns, None, stand, stand))
        return plan_from(
            state, report, phases, com=com, number=number, swing_height=self._swing_height
        )


class WalkPlanner:
    """The steps of the task `walk`: equal ones, of which the last brings the feet together.

    The path goes on from where the feet are. The path does not make up for a step that a push has
    moved.
    """

    reacts = False

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self._build = FootstepBuilder(robot, config)
        self._walk = config.walk

    def plan(self, state: RobotState, *, com: np.ndarray, number: int) -> Plan | None:
        report, walk = state.steps, self._walk
        if report is None:
            return None
        # A step is a phase on one foot and one on both.
        left = walk.steps - (report.phase + 1) // 2 + (state.mode is not ContactMode.DOUBLE_SUPPORT)
        if left <= 0:
            return None
        advance = (walk.step_length, walk.step_sideways, walk.step_turn)
        return self._build.steps(state, advance, com=com, number=number, steps=min(left, MAX_STEPS))


class PathPlanner:
    """Steps along a path that a command gives: a velocity, or a goal on flat ground.

    A new `velocity` or `goal` counts from the robot's next phase on. A goal is the middle between
    the feet and their heading, in the plan's frame. With neither the robot comes to a stand.
    """

    reacts = False

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self.velocity = Velocity()
        self.goal: tuple[float, float, float] | None = None
        # A velocity by command has been given again since the last state, or holds until this time.
        self._renewed = False
        self._until_ns: int | None = None
        self._build = FootstepBuilder(robot, config)
        self._walk = config.walk

    def steer(self, command: EdgeCommand) -> bool:
        """Take a goal or a velocity from a command. Return whether it is not the present one."""
        before = self.goal, self.velocity
        if isinstance(command, Go):
            self.goal, self.velocity = (command.x, command.y, command.yaw), Velocity()
        else:
            velocity = Velocity(command.forward, command.left, command.turning)
            self.goal, self.velocity = None, velocity
            self._renewed = True
        return (self.goal, self.velocity) != before

    def plan(self, state: RobotState, *, com: np.ndarray, number: int) -> Plan | None:
        report = state.steps
        if report is None:
            return None
        advance, steps = self._advance(report)
        in_air = state.mode is not ContactMode.DOUBLE_SUPPORT
        if steps == 0 and not in_air:
            return None
        return self._build.steps(state, advance, com=com, number=number, steps=max(steps, 1))

    def expires(self, now_ns: int) -> bool:
        """Let a velocity that was not given again for `DRIVE_NS` end. Return whether it ends now.

        Call this at every state, with its time.
        """
        if self._renewed:
            self._renewed, self._until_ns = False, now_ns + DRIVE_NS
        elif self._until_ns is not None:
            if now_ns > self._until_ns:
                self.velocity, self._until_ns = Velocity(), None
                return True
            # One state with a wrong time must not let the velocity hold for ever.
            self._until_ns = min(self._until_ns, now_ns + DRIVE_NS)
        return False

    def _advance(self, report: StepReport) -> tuple[tuple[float, float, float], int]:
        """Length, sideways part and turn of each step, and the number of steps."""
        T = self._walk.step_duration
        if self.goal is None:
            wanted = self.velocity
            advance = (wanted.forward * T, wanted.left * T, wanted.turning * T)
            moves = any(abs(each) > 1e-6 for each in advance)
            return _bounded(advance), _VELOCITY_STEPS if moves else 0
        x, y, yaw = middle({each.foot: each for each in report.feet})
        dx, dy = self.goal[0] - x, self.goal[1] - y
        c, s = math.cos(yaw), math.sin(yaw)
        left = (c * dx + s * dy, -s * dx + c * dy, math.remainder(self.goal[2] - yaw, math.tau))
        if math.hypot(left[0], left[1]) < _AT_GOAL and abs(left[2]) < _TURNED_TO_GOAL:
            return (0.0, 0.0, 0.0), 0
        n = max(1, *(math.ceil(abs(each) / most) for each, most in zip(left, _MOST, strict=True)))
        part = (left[0] / n, left[1] / n, left[2] / n)
        # The last step brings the feet together.
        return part, min(n + 1, MAX_STEPS)


def _bounded(advance: tuple[float, float, float]) -> tuple[float, float, float]:
    """The same advance, scaled down as a whole so that a step can make each of its parts."""
    ratio = max(1.0, *(abs(each) / most for each, most in zip(advance, _MOST, strict=True)))
    return advance[0] / ratio, advance[1] / ratio, advance[2] / ratio


def make_planner(robot: Robot, config: RunConfig, law: StepLaw) -> Planner:
    """Return the planner of a task. Raise `ConfigError` if the task has none."""
    if config.task == "balance":
        alone = config.stepping.mode == "edge"
        return ReactivePlanner(robot, config, law) if alone else StandingPlanner(robot, config)
    if config.task == "walk":
        return WalkPlanner(robot, config)
    if config.task == "go":
        if parse_ground(config.ground).kind != "flat":
            return GroundPlanner(robot, config)
        planner = PathPlanner(robot, config)
        place = config.walk.place
        planner.goal = (place.x, place.y, place.yaw)
        return planner
    raise ConfigError(f"stepping: expected the task balance, walk or go, got {config.task!r}")
