"""One state in, one projector out; always the newest state of each robot, never a queue.

Pure: takes bytes and returns bytes. A state that cannot be used is counted under its reason; a QP
that cannot be solved is counted under its status, and the robot goes on with what it has.
`edge_node/session.py` keeps what belongs to one robot apart from the others.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np

from edge_node.session import RobotSession, Sessions
from edge_node.step_planning import StepPlanning
from shared.bus.base import RefusalCounter
from shared.config.settings import RunConfig
from shared.errors import ConfigError, MessageRefused
from shared.robots import Robot
from shared.telemetry.schema import SOLVE_SCHEMA
from shared.wbc.answer import Projector, TimedProjector
from shared.wbc.assisted import apply_projector
from shared.wbc.contacts import ContactMode
from shared.wbc.projector import WholeBodySolution
from shared.wbc.qp import QpStatus
from shared.wbc.reference import Motion, coming_switches
from shared.wbc.stack import N_DYNAMICS
from shared.wbc.whole_body import WholeBodyController
from shared.wire.channels import DOWNLINK
from shared.wire.codec import Codec
from shared.wire.messages import (
    FactorisationMessage,
    PlanMessage,
    ProjectorMessage,
    RobotState,
)
from shared.wire.operator.commands import EdgeCommand
from shared.wire.plans import PlanCodec

# The prediction of the posture, as a part of the refresh distance, and its maximum [rad].
# Velocities do not predict further.
_LEAD, _MAX_LEAD = 0.7, 0.05
# The bytes of a message of two projectors without their numbers.
_MESSAGE_BYTES = 2_500
_STATUS_INDEX = {status: index for index, status in enumerate(QpStatus)}


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of the edge for one state of `robot`: `data` to publish, or None if there was no
    solution.
    """

    robot: str
    state_sequence: int
    solution: WholeBodySolution
    data: bytes | None

    def record(self, row: np.ndarray, *, wall_ns: int, solve_ns: int) -> None:
        """Fill a row of `SOLVE_SCHEMA`."""
        columns = SOLVE_SCHEMA.slices
        row[columns["wall_ns"]] = wall_ns
        row[columns["state_sequence"]] = self.state_sequence
        row[columns["solve_ns"]] = solve_ns
        row[columns["status"]] = _STATUS_INDEX[self.solution.status]
        row[columns["iterations"]] = self.solution.iterations
        projector = self.solution.projector
        row[columns["active_set"]] = -1 if projector is None else projector.active_set


class EdgeNode:
    """The full controller at the far end of the link, for robots of one kind with the same task."""

    def __init__(self, robot: Robot, config: RunConfig, motion: Motion) -> None:
        self.refused_from: defaultdict[str, RefusalCounter] = defaultdict(RefusalCounter)
        self.sessions = Sessions(robot, config, motion)
        self.solved: Counter[str] = Counter()
        self._controller = WholeBodyController(robot, config, motion)
        self._codec = Codec(robot, config, motion)
        self._plan_codec = PlanCodec(self._codec)
        self._motion = motion
        self._config = config
        self._plans: list[tuple[str, bytes]] = []
        self._stepper = None if config.stepping.mode == "off" else StepPlanning(robot, config)
        signs = np.random.default_rng([config.seed, 11]).choice([-1.0, 1.0], robot.model.nv - 6)
        self._posture_error = config.correction.posture_error * signs

    @property
    def refused(self) -> RefusalCounter:
        """States refused so far, of all robots."""
        return sum(self.refused_from.values(), RefusalCounter())

    def receive(self, data: bytes, now_ns: int, *, robot: str = "") -> None:
        """Take in a message that has arrived on the key of `robot`.

        Keep its state if it is valid and newer than the last one of its session.
        """
        try:
            state = self._codec.decode_state(data)
            self.sessions.take(robot, state, now_ns=now_ns)
        except MessageRefused as refusal:
            self.refused_from[robot][refusal.reason] += 1

    def step(self) -> Answer | None:
        """Answer the state whose turn it is, once. Return None if no answer is due."""
        while (turn := self.sessions.next()) is not None:
            robot, session, state = turn
            self._controller.last_active = session.last_active
            if self._stepper is not None:
                self._plan_steps(self._stepper, robot, session, state)
            if state.held_sequences is None:
                return self._project(robot, session, state)
            answer = self._factorise(robot, session, state, state.held_sequences)
            if answer is not None:
                return answer
        return None

    def steer(self, command: EdgeCommand) -> bool:
        """Carry out an operator's command. Return whether it changes the goal or the velocity.

        Raise `ConfigError` if the robots do not step by touch. This may run on any thread.
        """
        if self._stepper is None:
            raise ConfigError(
                f"{command}: expected robots that step by touch, got --stepping off; start the "
                "stack with --stepping on, see docs/stepping.md"
            )
        return self._stepper.steer(command)

    def take_plans(self) -> list[tuple[str, bytes]]:
        """Return the robot and the message of each plan and step law to send now."""
        plans, self._plans = self._plans, []
        return plans

    def _plan_steps(
        self, stepper: StepPlanning, robot: str, session: RobotSession, state: RobotState
    ) -> None:
        content = session.steps.due(state, stepper, self._controller.model)
        if content is not None:
            message = PlanMessage(state.session, state.sequence, state.stamp_ns, content)
            self._plans.append((robot, self._plan_codec.encode(message)))

    def solve(self, state: RobotState) -> tuple[WholeBodySolution, np.ndarray]:
        """Solve the full QP at a state. Return its solution and b. Count and encode nothing."""
        return self._controller.solve(
            state.q,
            state.v,
            time_ns=state.time_ns,
            mode=state.mode,
            com_command=state.com_command,
            reference=None if self._stepper is None else self._stepper.reference(state),
        )

    def _project(self, robot: str, session: RobotSession, state: RobotState) -> Answer:
        """A projector for a robot that applies it; no data if the QP has no solution."""
        controller = self._controller
        solution, b = self.solve(state)
        self.solved[solution.status.value] += 1
        if solution.status is not QpStatus.SOLVED or solution.projector is None:
            return Answer(robot, state.sequence, solution, None)
        # Rounded first, so that the sent torque is the result of the sent projector.
        projector = self._codec.rounded(solution.projector)
        assisted = apply_projector(
            controller.stacks[state.mode],
            projector,
            b,
            model=controller.model,
            q=state.q,
            v=state.v,
        )
        message = ProjectorMessage(
            session=state.session,
            sequence=state.sequence,
            stamp_ns=state.stamp_ns,
            mode=state.mode,
            tau=assisted.force[N_DYNAMICS:].copy(),
            y=assisted.y,
            projectors=(
                controller.timed(projector, from_ns=state.time_ns),
                *self._prepared(session, state, projector),
            ),
        )
        return Answer(robot, state.sequence, solution, self._codec.encode_projector(message))

    def _factorise(
        self,
        robot: str,
        session: RobotSession,
        state: RobotState,
        held_sequences: tuple[int, ...],
    ) -> Answer | None:
        """Factorisations for a robot that corrects, where it needs new ones; or a sign of life."""
        correction = self._config.correction
        session.posture.observe(state.q, state.v, stamp_ns=state.stamp_ns)
        modes = session.refresh.due(state, held_sequences, posture=session.posture.now)
        if modes is None:
            return None
        # Ahead of a robot in motion: it then passes this posture half-way through its use.
        posture = session.posture.ahead(min(_LEAD * correction.refresh_distance, _MAX_LEAD))
        q = state.q.copy()
        q[7:] = posture + self._posture_error
        factorisations = self._controller.factorise(q, modes, damping=correction.damping)
        if factorisations is None:
            self.solved[QpStatus.NOT_FINITE.value] += 1
            failed = WholeBodySolution(QpStatus.NOT_FINITE, None, 0)
            return Answer(robot, state.sequence, failed, None)
        session.refresh.sent(state, modes, posture=posture)
        self.solved[QpStatus.SOLVED.value] += 1
        message = FactorisationMessage(
            session=state.session,
            sequence=state.sequence,
            stamp_ns=state.stamp_ns,
            factorisations=factorisations,
        )
        solution = WholeBodySolution(QpStatus.SOLVED, None, 0)
        return Answer(robot, state.sequence, solution, self._codec.encode_factorisations(message))

    def _prepared(
        self, session: RobotSession, state: RobotState, projector: Projector
    ) -> tuple[TimedProjector, ...]:
        """Projectors of the coming contact modes beside that of a state."""
        config = self._config.switch
        if not config.prepare_on_edge:
            return ()
        room = DOWNLINK.max_bytes - _MESSAGE_BYTES - self._codec.n_bytes(projector)
        if self._stepper is not None:
            return self._prepared_for_steps(session, state, self._stepper, room=room)
        prepared = [
            self._controller.projector_for(
                state.q, state.v, time_ns=switch_ns, com_command=state.com_command
            )
            for switch_ns in coming_switches(self._motion, state.time_ns)
            if switch_ns - state.time_ns <= config.prepare_ns
        ]
        fitting = []
        for timed in prepared:
            # Three projectors of a robot with limits may be too long.
            if timed is not None and (n_bytes := self._codec.n_bytes(timed.projector)) <= room:
                room -= n_bytes
                fitting.append(timed)
        return tuple(fitting)

    def _prepared_for_steps(
        self, session: RobotSession, state: RobotState, stepper: StepPlanning, *, room: int
    ) -> tuple[TimedProjector, ...]:
        """The projector of a contact mode that a robot may enter by itself at any time.

        The two other modes take turns, because three projectors are too long for a message. In the
        air too: between two steps a robot is on both feet for 30 ms, and over a slower link no
        answer to a state of that time comes before it lifts the other foot. None if the projector
        takes more than `room` [bytes], as in double precision.
        """
        others = [mode for mode in ContactMode if mode is not state.mode]
        mode = others[session.prepared is others[0]]
        session.prepared = mode
        reference = stepper.reference(state)
        if reference is not None:
            reference.mode, reference.swing = mode, None
        controller = self._controller
        solution, _ = controller.solve(
            state.q,
            state.v,
            time_ns=state.time_ns,
            mode=mode,
            com_command=state.com_command,
            reference=reference,
        )
        projector = solution.projector
        if projector is None or self._codec.n_bytes(projector) > room:
            return ()
        return (controller.timed(projector, from_ns=state.time_ns),)
