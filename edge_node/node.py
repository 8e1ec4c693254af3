"""One state in, one projector out; always the newest state, never a queue.

Pure: takes bytes and returns bytes. A state that cannot be used is counted under its reason; a QP
that cannot be solved is counted under its status, and the robot goes on with what it has.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from edge_node.posture import PostureEstimate
from edge_node.refresh import FactorisationRefresh
from shared.bus.base import RefusalCounter
from shared.config.settings import RunConfig
from shared.errors import MessageRefused
from shared.robots import Robot
from shared.telemetry.schema import SOLVE_SCHEMA
from shared.wbc.answer import TimedProjector
from shared.wbc.projector import WholeBodySolution
from shared.wbc.qp import QpStatus
from shared.wbc.reference import Motion, coming_switches
from shared.wbc.torque import recover_torque
from shared.wbc.whole_body import WholeBodyController
from shared.wire.codec import Codec
from shared.wire.messages import FactorisationMessage, ProjectorMessage, RobotState

# Of the refresh distance, and at most so far [rad]: further ahead velocities tell little.
_LEAD, _MAX_LEAD = 0.7, 0.05
_STATUS_INDEX = {status: index for index, status in enumerate(QpStatus)}


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of the edge for one state: `data` to publish, or None if there was no solution."""

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
    """The full controller at the far end of the link."""

    def __init__(self, robot: Robot, config: RunConfig, motion: Motion) -> None:
        self.refused = RefusalCounter()
        self.solved: Counter[str] = Counter()
        self._controller = WholeBodyController(robot, config.wbc, motion)
        self._codec = Codec(robot, config, motion)
        self._motion = motion
        self._config = config
        signs = np.random.default_rng([config.seed, 11]).choice([-1.0, 1.0], robot.model.nv - 6)
        self._posture_error = config.correction.posture_error * signs
        self._posture = PostureEstimate(config.correction.average_ns)
        self._refresh = FactorisationRefresh(config.correction, motion)
        self._newest: RobotState | None = None
        self._last_seen: tuple[int, int] | None = None

    def receive(self, data: bytes) -> None:
        """Take a message in. Keep its state if it is valid and newer than the last one."""
        try:
            state = self._codec.decode_state(data)
            if self._last_seen is not None:
                session, sequence = self._last_seen
                if state.session == session and state.sequence <= sequence:
                    raise MessageRefused("stale", f"{state.sequence} after {sequence}")
        except MessageRefused as refusal:
            self.refused[refusal.reason] += 1
            return
        self._last_seen = (state.session, state.sequence)
        self._newest = state

    def step(self) -> Answer | None:
        """Answer the newest state, once. Return None if there is none."""
        state, self._newest = self._newest, None
        if state is None:
            return None
        if state.held_sequences is not None:
            return self._factorise(state, state.held_sequences)
        return self._project(state)

    def solve(self, state: RobotState) -> tuple[WholeBodySolution, np.ndarray]:
        """Solve the full QP at a state. Return its solution and b. Count and encode nothing."""
        return self._controller.solve(state.q, state.v, time_ns=state.time_ns, mode=state.mode)

    def _project(self, state: RobotState) -> Answer:
        """A projector for a robot that applies it; no data if the QP has no solution."""
        controller = self._controller
        solution, b = self.solve(state)
        self.solved[solution.status.value] += 1
        if solution.status is not QpStatus.SOLVED or solution.projector is None:
            return Answer(state.sequence, solution, None)
        # Rounded first, so that the torque sent is the one that the projector sent gives.
        projector = self._codec.rounded(solution.projector)
        y = projector.apply(b)
        contacts = controller.stacks[state.mode].contacts
        message = ProjectorMessage(
            session=state.session,
            sequence=state.sequence,
            stamp_ns=state.stamp_ns,
            mode=state.mode,
            tau=recover_torque(controller.model, contacts, state.q, state.v, y),
            y=y,
            projectors=(controller.timed(projector, from_ns=state.time_ns), *self._prepared(state)),
        )
        return Answer(state.sequence, solution, self._codec.encode_projector(message))

    def _factorise(self, state: RobotState, held_sequences: tuple[int, ...]) -> Answer | None:
        """Factorisations for a robot that corrects, where it needs new ones; or a sign of life."""
        correction = self._config.correction
        self._posture.observe(state.q, state.v, stamp_ns=state.stamp_ns)
        modes = self._refresh.due(state, held_sequences, posture=self._posture.now)
        if modes is None:
            return None
        # Ahead of a robot in motion: it then passes this posture half-way through its use.
        posture = self._posture.ahead(min(_LEAD * correction.refresh_distance, _MAX_LEAD))
        q = state.q.copy()
        q[7:] = posture + self._posture_error
        factorisations = self._controller.factorise(q, modes, damping=correction.damping)
        if factorisations is None:
            self.solved[QpStatus.NOT_FINITE.value] += 1
            return Answer(state.sequence, WholeBodySolution(QpStatus.NOT_FINITE, None, 0), None)
        self._refresh.sent(state, modes, posture=posture)
        self.solved[QpStatus.SOLVED.value] += 1
        message = FactorisationMessage(
            session=state.session,
            sequence=state.sequence,
            stamp_ns=state.stamp_ns,
            factorisations=factorisations,
        )
        solution = WholeBodySolution(QpStatus.SOLVED, None, 0)
        return Answer(state.sequence, solution, self._codec.encode_factorisations(message))

    def _prepared(self, state: RobotState) -> tuple[TimedProjector, ...]:
        """Projectors of the coming contact modes, shortly before the switches to them."""
        config = self._config.switch
        if not config.prepare_on_edge:
            return ()
        prepared = [
            self._controller.projector_for(state.q, state.v, time_ns=switch_ns)
            for switch_ns in coming_switches(self._motion, state.time_ns)
            if switch_ns - state.time_ns <= config.prepare_ns
        ]
        return tuple(timed for timed in prepared if timed is not None)
