"""Lockstep: all nodes in one process on a simulated clock, with an event queue.

The nodes, the codec and the delay lines are those of a live run. Clock, bus and driver differ.
Events run in the order of (time, rank, number). At equal times the order is: deliveries, the edge's
answers, the robot's phases. Compute times are configured, never measured. The same configuration
and seed therefore give the same trial to the last bit.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_node.node import Answer, EdgeNode
from netem.delay_line import DelayLine, Due, apply_to, make_lines
from netem.networks import load_network, profile_of
from netem.profile import DOWNLINK as DOWN
from netem.profile import UPLINK as UP
from netem.profile import Profile, profile_report
from netem.shim import record_message
from robot_node.controllers import MakeController, make_controller
from robot_node.node import RobotNode
from robot_node.tick import Tick
from shared.bus.base import Delivery, Inbox
from shared.bus.memory import MemoryBus
from shared.clock import SimClock
from shared.config.settings import RunConfig
from shared.errors import ConfigError, LinkError
from shared.motion.plan import MakeMotion, make_motion
from shared.output.fall import torque_limits
from shared.output.link_met import link_met
from shared.output.no_start import why_not_begun
from shared.output.report import discrepancy_report, edge_report, link_report, merge, robot_report
from shared.output.summary import summary
from shared.robots import load_robot
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA, Schema
from shared.wire.channels import DOWNLINK, PLANS, UPLINK
from shared.wire.codec import Codec
from shared.wire.operator.commands import Command, EdgeCommand, LinkCommand, Reset
from shared.wire.operator.events import CommandEvent

_RANK_DELIVERY, _RANK_EDGE, _RANK_MEASURE, _RANK_COMMAND = range(4)


@dataclass(frozen=True)
class TrialResult:
    """The summary of a trial, its telemetry rows, and its commands with their times.

    Without steps by touch there are no `step_rows`.
    """

    summary: dict[str, Any]
    schema: Schema
    rows: np.ndarray
    link_rows: np.ndarray
    solve_rows: np.ndarray
    step_rows: np.ndarray
    events: tuple[CommandEvent, ...] = ()


class Lockstep:
    """One trial. `run` plays it until its duration has passed or the robot falls.

    With `all_active_sets`, states that the edge did not solve are solved after the trial. They give
    the discrepancy of the active set at every tick, and change metrics only. `make_motion` and
    `make_controller` replace the task and the robot's controller that the configuration names.

    `events` are commands of an operator, each for the first tick at or after its time. Simulated
    time knows no pace, so that a pause is an event without an effect.
    """

    def __init__(
        self,
        config: RunConfig,
        *,
        all_active_sets: bool = True,
        make_motion: MakeMotion = make_motion,
        make_controller: MakeController = make_controller,
        events: Iterable[CommandEvent] = (),
    ) -> None:
        self.config = config
        self.done: list[CommandEvent] = []
        self._coming = deque(sorted(events, key=lambda event: event.time_ns))
        self.clock = SimClock()
        robot = load_robot(config.robot.name)
        motion = make_motion(robot, config)
        self.robot = RobotNode(robot, config, motion, session=1, make_controller=make_controller)
        self.edge = EdgeNode(robot, config, motion)
        self._codec = Codec(robot, config, motion)
        self._all_active_sets = all_active_sets
        self._unsolved: dict[int, bytes] = {}
        self.ticks = RowLog(self.robot.schema, complete=self.robot.tick_row.complete)
        self.steps = RowLog(STEP_SCHEMA)
        self._tick = Tick(self.robot, self.ticks.row, self.steps)
        self.link = RowLog(LINK_SCHEMA)
        self.solves = RowLog(SOLVE_SCHEMA)
        self._events: list[tuple[int, int, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._edge_busy = False
        self._edge_inbox, self._robot_inbox, self._plan_inbox = (
            Inbox(now_ns=self.clock.now_ns) for _ in range(3)
        )
        self._torque_limits = torque_limits(robot, clamp=config.robot.torque_clamp)
        self._profile: Profile | None = None
        self._lines: list[DelayLine[Delivery]] = []
        self._connect(robot.name)
        self._profiles = [self._profile_of(event.command) for event in self._coming]

    def at(self, time_ns: int, rank: int, action: Callable[[], None]) -> None:
        """Schedule an action at a time [ns]; at equal times a lower rank runs first."""
        heapq.heappush(self._events, (time_ns, rank, next(self._numbers), action))

    def run(self) -> TrialResult:
        """Play the trial. Raise LinkError if no answer arrives within `loop.connect_timeout`."""
        started = time.perf_counter()
        duration_ns = round(self.config.duration * 1e9)
        waiting_limit_ns = round(self.config.loop.connect_timeout * 1e9)
        self.at(0, _RANK_MEASURE, self._measure)
        while self._events and self.robot.time_ns < duration_ns and self._goes_on:
            self.clock.time_ns, _, _, action = heapq.heappop(self._events)
            action()
            if not self.robot.running and self.clock.time_ns > waiting_limit_ns:
                raise LinkError(self._why_not_begun())
        return self._result(wall_seconds=time.perf_counter() - started)

    @property
    def _goes_on(self) -> bool:
        """Return whether the robot stands, or will be reset."""
        return not self.robot.fallen or any(isinstance(e.command, Reset) for e in self._coming)

    def _connect(self, robot: str) -> None:
        near, far = MemoryBus(self.clock), MemoryBus(self.clock)
        up_key, down_key = UPLINK.key_for(robot), DOWNLINK.key_for(robot)
        plans_key = PLANS.key_for(robot)
        config = self.config
        if config.link.network == "direct":
            far = near
        else:
            profile = load_network(config.link.network)
            self._profile = profile
            self._lines = make_lines(profile, config.link, seed=config.seed, start_ns=0)
            down = self._shim(
                DOWN, near.publisher(down_key).forward, near.publisher(plans_key).forward
            )
            near.subscribe(up_key, self._shim(UP, far.publisher(up_key).forward))
            far.subscribe(down_key, down)
            far.subscribe(plans_key, lambda delivery: down(delivery._replace(on_plans=True)))
        self._uplink = near.publisher(up_key)
        self._downlink = far.publisher(down_key)
        self._plans = far.publisher(plans_key)
        far.subscribe(up_key, self._edge_receives)
        near.subscribe(down_key, self._robot_inbox.put)
        near.subscribe(plans_key, self._plan_inbox.put)

    def _shim(
        self,
        direction: int,
        forward: Callable[[Delivery], None],
        forward_plan: Callable[[Delivery], None] | None = None,
    ) -> Callable[[Delivery], None]:
        line = self._lines[direction]

        def release() -> None:
            now_ns = self.clock.now_ns()
            for due in line.pop_due(now_ns):
                record_message(self.link.row(), direction, due, released_ns=now_ns)
                if due.item.on_plans and forward_plan is not None:
                    forward_plan(due.item)
                else:
                    forward(due.item)

        def receive(delivery: Delivery) -> None:
            sent_ns = self.clock.now_ns()
            due_ns = line.push(delivery, sent_ns=sent_ns, size=len(delivery.data))
            if due_ns is None:
                lost = Due(delivery, sent_ns, 0)
                record_message(self.link.row(), direction, lost, released_ns=None)
            else:
                self.at(due_ns, _RANK_DELIVERY, release)

        return receive

    def _edge_receives(self, delivery: Delivery) -> None:
        self._edge_inbox.put(delivery)
        if not self._edge_busy:
            self._edge_starts()

    def _edge_starts(self) -> None:
        for delivery in self._edge_inbox.take():
            self.edge.receive(delivery.data, self.clock.now_ns())
        started = time.perf_counter_ns()
        answer = self.edge.step()
        plans = self.edge.take_plans()
        if answer is None and not plans:
            return
        solve_ns = time.perf_counter_ns() - started
        if answer is not None:
            answer.record(self.solves.row(), wall_ns=self.clock.now_ns(), solve_ns=solve_ns)
            if answer.solution.projector is not None:
                self._unsolved.pop(answer.state_sequence, None)
        self._edge_busy = True

        def finish() -> None:
            self._edge_busy = False
            for _, plan in plans:
                self._plans.publish(plan)
            if answer is not None and answer.data is not None:
                self._downlink.publish(answer.data)
            self._edge_starts()

        self.at(self.clock.now_ns() + self.config.loop.edge_compute_ns, _RANK_EDGE, finish)

    def _profile_of(self, command: Command) -> Profile | None:
        """Return the profile that a command names. Raise `UserError` for one without effect."""
        if not isinstance(command, LinkCommand):
            return None
        if not self._lines:
            raise ConfigError(f"{command}: expected a link, got --network direct; try constant:0ms")
        return profile_of(command)

    def _carry_out(self, command: Command, profile: Profile | None) -> None:
        """Carry out an operator's command before the next tick."""
        if isinstance(command, LinkCommand):
            apply_to(
                self._lines,
                command,
                now_ns=self.clock.now_ns(),
                profile=profile,
                config=self.config.link,
                seed=self.config.seed,
            )
        elif isinstance(command, EdgeCommand):
            self.edge.steer(command)
        else:
            self.robot.prepare(command)()
        self.done.append(CommandEvent(self.robot.time_ns, command))

    def _measure(self) -> None:
        while self._coming and self._coming[0].time_ns <= self.robot.time_ns:
            self._carry_out(self._coming.popleft().command, self._profiles.pop(0))
        now_ns = self.clock.now_ns()
        data = self._tick.begin(now_ns)
        if self._all_active_sets:
            self._unsolved[self.robot.tick] = data
        self._uplink.publish(data)
        loop = self.config.loop
        self.at(now_ns + loop.fresh_within_ns, _RANK_COMMAND, self._command)
        self.at(now_ns + loop.period_ns, _RANK_MEASURE, self._measure)

    def _command(self) -> None:
        self._tick.end(self.clock.now_ns(), self._robot_inbox.take(), plans=self._plan_inbox.take())

    def _result(self, *, wall_seconds: float) -> TrialResult:
        robot, edge, link = self._reports(wall_seconds=wall_seconds)
        rows, link_rows, solve_rows = self.ticks.rows(), self.link.rows(), self.solves.rows()
        steady = self.robot.controller.every_state_answered
        return TrialResult(
            summary=summary(
                self.config,
                robot=robot,
                edge=edge,
                link=link,
                discrepancy=self._discrepancy(rows, solve_rows),
                met=link_met(self.robot.schema, rows, link_rows, solve_rows, steady=steady),
            ),
            schema=self.robot.schema,
            rows=rows,
            link_rows=link_rows,
            solve_rows=solve_rows,
            step_rows=self.steps.rows(),
            events=tuple(self.done),
        )

    def _reports(self, *, wall_seconds: float) -> tuple[dict[str, Any], ...]:
        """The reports of robot, edge and link, as a live run's processes write them."""
        for log in (self.ticks, self.steps, self.link, self.solves):
            log.close()
        robot = robot_report(
            self.robot.schema,
            self.ticks.rows(),
            fell=self.robot.fallen,
            wall_seconds=wall_seconds,
            sent=self._uplink.sent,
            received=self._robot_inbox.counter.received,
            lost=self._robot_inbox.counter.lost,
            refused=dict(self.robot.refused),
            answers=self.robot.answers.by_sender,
            sensor_faults=dict(self.robot.sensor_guard.faults),
            base_estimate=self.robot.base_estimate,
            torque_limits=self._torque_limits,
        )
        edge = edge_report(
            self.solves.rows(),
            statuses=dict(self.edge.solved),
            sent=self._downlink.sent,
            received=self._edge_inbox.counter.received,
            lost=self._edge_inbox.counter.lost,
            refused=dict(self.edge.refused),
        )
        profile, config = self._profile, self.config
        link = link_report(
            self.link.rows(),
            profile={"profile": "direct"}
            if profile is None
            else profile_report(profile, config.link, seed=config.seed),
            passes=max((line.passes(self.clock.now_ns()) for line in self._lines), default=0),
        )
        return robot, edge, link

    def _why_not_begun(self) -> str:
        robot, edge, link = self._reports(wall_seconds=0.0)
        parts = merge({"network": self.config.link.network}, robot, edge, link)
        return (
            f"the task did not begin within {self.config.loop.connect_timeout:g} s of simulated "
            f"time over {self.config.link.network}: {why_not_begun(parts, self.config)}"
        )

    def _discrepancy(self, rows: np.ndarray, solve_rows: np.ndarray) -> dict[str, Any]:
        """The report of the active set (Table VI), with the states that the edge did not solve."""
        missed = RowLog(SOLVE_SCHEMA)
        for data in self._unsolved.values():
            state = self._codec.decode_state(data)
            solution, _ = self.edge.solve(state)
            Answer("", state.sequence, solution, None).record(missed.row(), wall_ns=0, solve_ns=0)
        missed.close()
        solved = np.concatenate([missed.rows(), solve_rows])
        return discrepancy_report(self.robot.schema, rows, solved)
