"""The robot's tick, in two phases.

`measure` senses and returns the state to send. `command`, d* later, produces the torque of this
tick by Eq. (7) from the messages that have arrived. It uses the answer to *this* state if it is
here, else the newest answer in the cache, else the joint hold. `advance` then ends the tick and
moves the simulated robot. `robot_node/tick.py` drives them.

The task time begins when the first answer arrives. Until then the robot stands still and sends. A
tick never raises: errors are counted by name. A measurement that is not a number gives a joint
hold, and no estimate is made from it, because a NaN would stay in every average.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from robot_node.cache import AnswerCache
from robot_node.controller_slot import ControllerSlot, OtherController
from robot_node.controllers import (
    Command,
    Controller,
    ControllerParts,
    MakeController,
    make_controller,
)
from robot_node.onboard import (
    MakeSolve,
    ModelledComputer,
    OnBoard,
    OnBoardComputer,
    StartComputer,
)
from robot_node.plan_anchor import SETTLED_NS, PlanAnchor
from robot_node.plan_cache import PlanCache
from robot_node.plant import Plant, make_plant
from robot_node.safety import JointHold, TorqueGuard, TorqueRateLimiter
from robot_node.sensor_guard import SensorGuard
from robot_node.sensors import Sensors
from robot_node.sent_states import SentStates
from robot_node.step_rows import StepRows
from robot_node.stepping import ContactClock, Measured
from robot_node.tick_row import Moment, TickRow
from shared.bus.base import Delivery, RefusalCounter, SenderCounter, new_session
from shared.config.quantities import Push
from shared.config.settings import RunConfig
from shared.motion.ground import make_ground
from shared.robots import Foot, Robot
from shared.robots.fallen import has_fallen
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import Schema, Source, tick_schema
from shared.wbc.contacts import ContactMode
from shared.wbc.finite import all_finite
from shared.wbc.limits import Limits
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Motion, Reference
from shared.wbc.stack import make_stacks
from shared.wire.codec import Codec
from shared.wire.messages import RobotState, StepReport
from shared.wire.operator.commands import PushCommand, Reset, RobotCommand, SwitchController

# Pushes of an operator that act at the same time.
_MAX_PUSHES = 20


class RobotNode:
    """Simulated robot and local controller.

    `session` names this start of the robot. `start_computer` starts the on-board computer if the
    controller asks for one, by default one whose compute time is modelled.
    """

    def __init__(
        self,
        robot: Robot,
        config: RunConfig,
        motion: Motion,
        *,
        session: int | None = None,
        start_computer: StartComputer | None = None,
        make_controller: MakeController = make_controller,
    ) -> None:
        self.schema: Schema = tick_schema(nq=robot.model.nq, nv=robot.model.nv)
        self.running = False
        self.fallen = False
        self.time_ns = 0
        self.tick = 0
        # The least age of an answer that was too old for its command.
        self.youngest_answer_ns: int | None = None
        self._config = config
        self._motion = self._whole_motion = motion
        self._ground = make_ground(config.plant_ground, seed=config.seed)
        self._plant = self._make_plant(robot)
        period_ns = config.loop.period_ns
        self._sensors = Sensors(config.sensors, seed=config.seed, period=period_ns * 1e-9)
        self.sensor_guard = SensorGuard(robot, config.sensors, period_ns=period_ns)
        self._contact_force = np.full(6, np.nan)
        self._model = WholeBodyModel(robot)
        stacks = make_stacks(robot, config.wbc, Limits.of(robot, config))
        self._guard = TorqueGuard(robot, clamp=config.robot.torque_clamp)
        self.tick_row = TickRow(self.schema, self._model, stacks, torque_limit=self._guard.limit)
        self._step_rows = StepRows(self._model)
        self._session = new_session() if session is None else session
        self.answers = SenderCounter()
        self._sent = SentStates(robot.model.nv - 6)
        self._codec = Codec(robot, config, motion)
        self._slot = ControllerSlot(
            ControllerParts(
                config=config,
                motion=motion,
                codec=self._codec,
                session=self._session,
                model=self._model,
                stacks=stacks,
                start_computer=start_computer or self._model_computer,
            ),
            make_controller,
        )
        self._pushes = config.pushes
        self.clock, self.plans = self._steps_of(self._session)
        self._torque_rate_limiter = TorqueRateLimiter(self._guard)
        self._last_rung = Source.HELD
        self._hold = JointHold(robot, timestep=config.loop.period_ns * 1e-9)
        self._plan = PlanAnchor(self._model)
        self._hold_after_ns = config.loop.hold_after * 1e9
        self._stays = motion.next_switch(0) is None
        self._standing_com_height = float(motion.reference(0).com[2])
        self._measured_ns = self._plan_ns = 0
        self._plan_frame = self._plan.frame
        self._stopping = self._lands = False
        self._true_state: tuple[np.ndarray, np.ndarray]
        self._q_in_world: np.ndarray
        self._q: np.ndarray
        self._v: np.ndarray
        self._known = False
        self._reference = motion.reference(0)

    @property
    def controller(self) -> Controller:
        """The controller of this tick."""
        return self._slot.controller

    @property
    def cache(self) -> AnswerCache:
        """The cache that takes the answers."""
        return self._slot.cache

    @property
    def on_board(self) -> OnBoard | None:
        """The on-board computer, if the controller needs one."""
        return self._slot.controller.on_board

    @property
    def refused(self) -> RefusalCounter:
        """Messages refused so far, by reason."""
        if self.plans is None:
            return self.cache.refused
        return RefusalCounter(self.cache.refused + self.plans.refused)

    @property
    def base_estimate(self) -> dict[str, int]:
        """Jumps and drifts of the base's estimate so far."""
        return {"jumps": self.sensor_guard.base_jumps, "drifts": self._plan.drifts}

    @property
    def walk_ended(self) -> bool:
        """Return whether a joint hold has ended the walk."""
        return self._plan.ended

    def prepare(self, command: RobotCommand) -> Callable[[], None]:
        """Do the slow part of a command. Return a function that carries it out between two ticks.

        This may run on another thread than the tick, on one at a time. The commands that concern
        the pace of simulated time are the driver's. Raise `ConfigError` if the command cannot be
        carried out.
        """
        self._slot.close_retired()
        if isinstance(command, PushCommand):
            return partial(self._add_push, command)
        if isinstance(command, SwitchController):
            config = replace(self._slot.config, controller=command.controller)
            return partial(self._slot.begin_switch, self._slot.another(config, self._session))
        if isinstance(command, Reset):
            session = (self._session + 1) % 2**32
            made = self._slot.another(self._slot.next_config, session)
            return partial(self._reset, session, made, *self._steps_of(session))
        return _nothing

    def close(self) -> None:
        """End the processes of the on-board computer."""
        self._slot.close()

    def measure(self, now_ns: int) -> bytes:
        """First phase: sense, observe, and return the state message to send."""
        self._slot.follow()
        self._true_state = self._plant.state()
        measured = self._sensors.measure(*self._true_state)
        self._q_in_world, v = self.sensor_guard.check(*measured)
        # References are in the plan's frame and time, and so is the state from here on.
        self._plan_frame = self._plan.frame
        self._plan_ns = self.time_ns + self._plan.skipped_ns
        q = self._plan_frame.in_plan(self._q_in_world)
        self._q, self._v = q, v
        self._known = all_finite(q) and all_finite(v)
        forces: dict[Foot, np.ndarray] = {}
        if self._config.sensors.measure_forces or self.clock is not None:
            forces = self._sensors.forces(self._plant.contact_forces())
            self._contact_force = np.concatenate([forces[foot] for foot in Foot])
        if self._known:
            self._reference = self._next_reference(forces)
            self.controller.observe(q, v, self._reference)
        self._measured_ns = now_ns
        self._sent.add(self.tick, stamp_ns=now_ns, q=q, v=v)
        return self._codec.encode_state(
            RobotState(
                session=self._session,
                sequence=self.tick,
                stamp_ns=now_ns,
                time_ns=self._plan_ns,
                mode=self._reference.mode,
                q=q,
                v=v,
                held_sequences=self.cache.held_sequences,
                com_command=self.controller.com_command,
                steps=self._step_report(),
            )
        )

    def _next_reference(self, forces: dict[Foot, np.ndarray]) -> Reference:
        """The reference of this tick: of the contact clock, or of a motion by time."""
        if self.clock is None:
            return self._motion.reference(self._plan_ns)
        measured = Measured(
            self._model.kinematics(self._q, self._v), self.controller.disturbance, forces
        )
        on_both_feet = self.clock.mode is ContactMode.DOUBLE_SUPPORT
        held = self._hold.seconds > 0.0
        decides = self.running and not held and not (on_both_feet and self._answers_stall())
        return self.clock.reference(measured, time_ns=self._plan_ns, decides=decides)

    def _answers_stall(self) -> bool:
        """Return whether no foot may lift, because the newest answer would expire in the air.

        The projector of the coming contact mode is as old as the newest answer: the edge prepares
        those of the other two modes in turn. An edge that does not prepare one, as with
        `switch.prepare_on_edge` off, answers as soon as the robot is in that mode. A foot that
        waited for such a projector would never lift.
        """
        age_ns = self._measured_ns - self.cache.newest_stamp_ns
        allowed_ns = self._config.stepping.lift_within * self._hold_after_ns
        return self.controller.answers_expire and age_ns > allowed_ns

    def _step_report(self) -> StepReport | None:
        clock, plans = self.clock, self.plans
        if clock is None or plans is None:
            return None
        return StepReport(
            phase=clock.phase,
            phase_ns=clock.phase_ns,
            plan=plans.plan,
            law=plans.law,
            feet=(clock.feet[Foot.LEFT], clock.feet[Foot.RIGHT]),
            swing=self._reference.swing,
            disturbance=self.controller.disturbance,
        )

    def receive_plan(self, delivery: Delivery) -> bool:
        """Offer a message on the key of plans. Return whether it was taken."""
        if self.plans is None:
            return False
        return self.plans.offer(
            delivery.data, sent=self._sent, now_ns=self._measured_ns, time_ns=self._plan_ns
        )

    def receive(self, delivery: Delivery) -> bool:
        """Offer a message from the edge to the cache. Return whether it was taken."""
        taken = self._slot.offer(delivery.data, sent=self._sent)
        self.answers.count(delivery.envelope, taken=taken)
        return taken

    def command(self, now_ns: int) -> Command:
        """Second phase: the torque of this tick, Eq. (7)."""
        if not self._known:
            return self._held(age_ns=-1)
        self._solve_on_board()
        decision = self.controller.command(time_ns=self._plan_ns)
        if decision is None:
            return self._held(age_ns=-1)
        age_ns = now_ns - decision.stamp_ns
        expired = age_ns > self._hold_after_ns
        if self.controller.answers_expire and (expired or self._lands):
            if expired:
                youngest_ns = self.youngest_answer_ns
                youngest_ns = age_ns if youngest_ns is None else min(age_ns, youngest_ns)
                self.youngest_answer_ns = youngest_ns
            # A hold on one foot lasts until the other one is down.
            held = self._held(age_ns=age_ns)
            self._lands = self._hold.sets_foot_down
            return held
        safe = self._guard.accept(decision.tau)
        if safe is None:
            return self._held(age_ns=age_ns)
        self._hold.observe(
            self._q,
            on_both_feet=self._reference.mode is ContactMode.DOUBLE_SUPPORT,
            feet_as_standing=self._stays and (self.clock is None or self.clock.phase == 0),
        )
        if self.clock is None and self.running:
            self._plan.stand(self._q, self._motion, time_ns=self.time_ns)
        else:
            self._plan.release()
        source = Source.FRESH if decision.sequence == self.tick else decision.source
        if self._stopping and source is not Source.CACHED:
            source = Source.STOPPING
        if self.controller.should_stop():
            self._stop_walking()
        return Command(self._bounded(safe, source), source, age_ns, decision)

    def advance(
        self, command: Command, row: np.ndarray | None = None, steps: RowLog | None = None
    ) -> None:
        """End the tick: check for a fall, fill the telemetry rows, and step the plant.

        Before the first answer, and after a fall, the plant stands still. `row` is filled if it is
        given, and then `steps` gets the rows of footprints.
        """
        com, soles = self._model.com_and_soles(self._true_state[0])
        com_height = com[2] - self._ground.height(com[0], com[1])
        self.fallen = has_fallen(
            self._true_state[0],
            com_height=com_height,
            standing_com_height=self._standing_com_height,
        )
        push = self._push()
        if row is not None:
            moment = self._moment(command, com, soles, push)
            self.tick_row.fill(row, moment, command)
            if steps is not None and self.clock is not None:
                self._step_rows.fill(steps, moment, self.clock)
        if not self.running and command.source is not Source.HELD:
            self.running = True
            self._sensors.restart()
        self.tick += 1
        if not self.running:
            return
        if not self.fallen:
            self._plant.step(command.tau, push=push)
        self.time_ns += self._config.loop.period_ns

    def _moment(
        self, command: Command, com: np.ndarray, soles: dict[Foot, np.ndarray], push: np.ndarray
    ) -> Moment:
        q, v = self._true_state
        in_task = self.running or command.decision is not None
        return Moment(
            tick=self.tick,
            time_ns=self.time_ns if in_task else -1,
            wall_ns=self._measured_ns,
            q=q,
            v=v,
            com=com,
            soles=soles,
            measured=(self._q, self._v),
            reference=self._reference,
            plan_frame=self._plan_frame,
            plan_ns=self._plan_ns,
            push=push,
            contact_force=self._contact_force,
            on_board_qps=self._slot.on_board_qps,
            refused=self.refused.total_refused,
        )

    def _solve_on_board(self) -> None:
        if self.on_board is None or not self.running:
            return
        self.on_board.tick(
            self._q,
            self._v,
            time_ns=self._plan_ns,
            sequence=self.tick,
            stamp_ns=self._measured_ns,
        )

    def _stop_walking(self) -> None:
        """End a walk with the step that follows this one. Do so once, and only if there is a walk
        to end.
        """
        if not self._stopping:
            before, self._motion = self._motion, self._motion.stopped(self._plan_ns)
            self._stopping = self._motion is not before

    def _bounded(self, tau: np.ndarray, source: Source) -> np.ndarray:
        """Return the torque; bound its step at a change of rung, if the controller asks for that.

        Fresh, corrected and on-board answers are one rung, because all lead to the same solution.
        """
        if not (self.running and self.controller.bounds_torque_steps):
            return tau
        rung = source if source in (Source.HELD, Source.CACHED) else Source.FRESH
        changed, self._last_rung = rung is not self._last_rung, rung
        return self._torque_rate_limiter.bound(tau, changed=changed)

    def _held(self, *, age_ns: int) -> Command:
        if self.plans is not None:
            # The robot does not move as the plan expects, and is on its way to a stand.
            if self.running and self._hold.seconds * 1e9 >= SETTLED_NS:
                self.plans.drop(self.tick)
        elif self.running and self._known:
            self._plan.hold(
                self._q_in_world,
                self._motion,
                time_ns=self.time_ns,
                period_ns=self._config.loop.period_ns,
            )
        tau = self._guard.accept(self._hold.torque(self._q, self._v))
        if tau is None:
            tau = np.zeros_like(self._guard.limit)
        return Command(self._bounded(tau, Source.HELD), Source.HELD, age_ns, None)

    def _push(self) -> np.ndarray:
        force = np.zeros(3)
        for push in self._pushes:
            if push.active(self.time_ns):
                force += push.force
        return force

    def _add_push(self, command: PushCommand) -> None:
        """Add a push from this tick on, and forget pushes that are over."""
        lasting = [each for each in self._pushes if not each.over(self.time_ns)]
        push = Push(command.vector, self.time_ns, command.duration_ns)
        self._pushes = (*lasting[:_MAX_PUSHES], push)

    def _reset(
        self,
        session: int,
        other: OtherController,
        clock: ContactClock | None,
        plans: PlanCache | None,
    ) -> None:
        """Put the robot at the beginning of its task. For the edge this is a new session."""
        robot, config = self._model.robot, other.config
        period_ns = config.loop.period_ns
        self._slot.replace(other)
        self._session = session
        if self.plans is not None and plans is not None:
            plans.refused.update(self.plans.refused)
        self.clock, self.plans = clock, plans
        self._plant.set_state(robot.q_standing, np.zeros(robot.model.nv))
        before, drifts = self.sensor_guard, self._plan.drifts
        self.sensor_guard = SensorGuard(robot, config.sensors, period_ns=period_ns)
        self.sensor_guard.faults.update(before.faults)
        self.sensor_guard.base_jumps = before.base_jumps
        self.tick_row.forget_soles()
        self._hold = JointHold(robot, timestep=period_ns * 1e-9)
        self._torque_rate_limiter = TorqueRateLimiter(self._guard)
        self._motion = self._whole_motion
        self._plan = PlanAnchor(self._model, skipped_ns=-self.time_ns)
        self._plan.drifts = drifts
        self._pushes = tuple(each for each in self._pushes if each.start_ns > self.time_ns)
        self._stopping = self._lands = self.fallen = False

    def _steps_of(self, session: int) -> tuple[ContactClock | None, PlanCache | None]:
        """Make the contact clock and the plans of one start of the robot, if it steps by touch."""
        if self._config.stepping.mode == "off":
            return None, None
        clock = ContactClock(self._model.robot, self._config)
        whole = self._config.stepping.mode == "on"
        plans = PlanCache(
            *(self._codec, self._model.robot, clock),
            session=session,
            ground=clock.ground,
            whole_plans=whole,
        )
        return clock, plans

    def _model_computer(self, make_solve: MakeSolve) -> OnBoardComputer:
        config = self._config
        ready_after_ns = config.switch.ready_after_ns(config.switch.compute_ns)
        solve = make_solve(self._model.robot, config, self._whole_motion)
        return ModelledComputer(solve, ready_after_ns=ready_after_ns)

    def _make_plant(self, robot: Robot) -> Plant:
        timestep = self._config.loop.period_ns * 1e-9
        return make_plant(robot, self._config.plant, timestep=timestep, ground=self._ground)


def _nothing() -> None:
    """Do nothing: the driver carries out this command."""
