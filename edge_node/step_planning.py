"""The edge's part in steps: the step law and plans, sent until the robot says that it has them."""

from __future__ import annotations

import dataclasses

import numpy as np

from edge_node.planner import PathPlanner, Planner, make_planner
from shared.config.settings import RunConfig
from shared.motion.ground import make_ground
from shared.motion.planned import Plan
from shared.motion.stance import Stance, middle
from shared.motion.standing import Standing
from shared.motion.step_law import StepLaw, make_step_law
from shared.robots import Robot
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Reference, turned
from shared.wire.messages import RobotState
from shared.wire.operator.commands import EdgeCommand
from shared.wire.plans import as_sent, law_identity

# The least time between two plans, because the key of plans has 50 Hz.
_INTERVAL_NS = 20_000_000


class StepPlanning:
    """The law, the planner and the standing posture, the same for all robots of an edge."""

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        stance = Stance.of(robot, lowering=config.walk.com_lowering)
        ground = make_ground(config.ground, seed=config.seed)
        self.law: StepLaw = as_sent(make_step_law(robot, stance, ground))
        self.law_identity = law_identity(self.law)
        self.planner: Planner = make_planner(robot, config, self.law)
        self._path = PathPlanner(robot, config)
        # The number of commands so far that change the plan.
        self.steered = 0
        # The planner on the edge alone decides without a law on the robot.
        self.sends_law = config.stepping.mode == "on"
        self._standing = Standing(robot).reference(0)

    def steer(self, command: EdgeCommand) -> bool:
        """Let the robots walk as a command says. Return whether the command changes anything."""
        new = self._path.steer(command) or self.planner is not self._path
        self.planner = self._path
        self.steered += new
        return new

    def note(self, now_ns: int) -> None:
        """Note the time of a state, by the robot's clock: a velocity holds for a while only."""
        self.steered += self._path.expires(now_ns)

    def reference(self, state: RobotState) -> Reference | None:
        """Return the reference that a robot has by its own report; None without one."""
        steps = state.steps
        if steps is None:
            return None
        _, _, yaw = middle({each.foot: each for each in steps.feet})
        return dataclasses.replace(
            self._standing,
            world_from_base=turned(yaw) @ self._standing.world_from_base,
            mode=state.mode,
            swing=steps.swing,
        )


class StepDelivery:
    """The law and the plans sent to one start of a robot, until its states say that it has them."""

    def __init__(self, retry_ns: int) -> None:
        self._retry_ns = retry_ns
        self._asked_ns = self._sent_ns = self._law_sent_ns = -(2**62)
        self._planned_phase = -1
        self._steered = 0
        self._round_trip_ns, self._arrived = 0, True
        self._number = -1

    def due(
        self, state: RobotState, planning: StepPlanning, model: WholeBodyModel
    ) -> Plan | StepLaw | None:
        """Return what to send as answer to a state; None if the robot has all."""
        steps, now_ns = state.steps, state.stamp_ns
        planning.note(now_ns)
        if steps is None or now_ns - self._asked_ns < _INTERVAL_NS:
            return None
        self._asked_ns = now_ns
        lacks_law = planning.sends_law and steps.law != planning.law_identity
        if lacks_law and now_ns - self._law_sent_ns >= self._retry_ns:
            self._law_sent_ns = now_ns
            return planning.law
        # No robot has had more plans than it has sent states. A larger number would go into every
        # later plan, and the robot would refuse them all.
        reported = min(steps.plan, state.sequence)
        lacking = reported < self._number
        if not lacking and not self._arrived:
            self._arrived, self._round_trip_ns = True, now_ns - self._sent_ns
        retry_ns = max(self._retry_ns, 1.2 * self._round_trip_ns)
        lacking = lacking and now_ns - self._sent_ns >= retry_ns
        planner, steered = planning.planner, planning.steered
        due = planner.reacts or steps.phase != self._planned_phase or steered != self._steered
        if not due and not lacking:
            return None
        self._steered = steered
        number = max(reported, self._number) + 1
        plan = planner.plan(state, com=_com(state, model), number=number)
        if plan is not None:
            self._sent_ns, self._number, self._planned_phase = now_ns, number, steps.phase
            self._arrived = False
        return plan


def _com(state: RobotState, model: WholeBodyModel) -> np.ndarray:
    """The CoM in the plane and its velocity, (2, 2)."""
    now = model.kinematics(state.q, state.v)
    return np.array((now.com[:2], now.com_velocity[:2]))
