"""The telemetry row of one tick: the true motion of the robot beside its command."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_node.controllers import Command, Decision
from shared.motion.plan_frame import PlanFrame
from shared.robots import Foot
from shared.telemetry.schema import Schema
from shared.wbc.contacts import FORCES_PER_FOOT, ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack


@dataclass(slots=True)
class Moment:
    """A tick when its command is there and the plant has not moved yet.

    `time_ns` is that of the task, −1 before it begins; `wall_ns` that of the measurement. `q`, `v`
    is the true state, `com` and `soles` its centre of mass and sole positions in the world [m];
    `measured` is the state from the sensors, in the plan's frame as `reference` is; `plan_frame`
    and `plan_ns` are the place of the plan. `push` is the external force on the base [N].
    `contact_force` (6,) is measured on the left and on the right foot [N].
    """

    tick: int
    time_ns: int
    wall_ns: int
    q: np.ndarray
    v: np.ndarray
    com: np.ndarray
    soles: dict[Foot, np.ndarray]
    measured: tuple[np.ndarray, np.ndarray]
    reference: Reference
    plan_frame: PlanFrame
    plan_ns: int
    push: np.ndarray
    contact_force: np.ndarray
    on_board_qps: int
    refused: int


class TickRow:
    """Fills rows of a schema, in the order of the ticks."""

    def __init__(
        self,
        schema: Schema,
        model: WholeBodyModel,
        stacks: dict[ContactMode, Stack],
        *,
        torque_limit: np.ndarray,
    ) -> None:
        # One write for all columns of a tick, which follow one another; see `tick_schema`.
        columns = self._columns = schema.slices
        self._filled = slice(columns["tick"].start, columns["torque_ratio"].start)
        self._loads = slice(columns["torque_ratio"].start, columns["contact_force_n"].start)
        self._contact_force = columns["contact_force_n"]
        self._refused = columns["refused"].start
        self._model = model
        self._robot = model.robot
        self._torque_limit = torque_limit
        self._stacks = stacks
        self._unloaded = np.zeros(FORCES_PER_FOOT)
        self._set_down: list[tuple[float, float] | None] = [None for _ in Foot]

    def fill(self, row: np.ndarray, moment: Moment, command: Command) -> None:
        """Fill all columns but the loads of the joints and the times that the driver of the tick
        measures.
        """
        reference, decision = moment.reference, command.decision
        frame = moment.plan_frame
        com_reference = frame.point_in_world(reference.com)
        error = moment.com - com_reference
        forces = (self._unloaded, self._unloaded)
        violation = contraction = staleness = math.nan
        sequence = active_set = -1
        if decision is not None:
            forces = self._forces(decision)
            violation = self._violation(moment, decision.y)
            sequence, active_set = decision.sequence, decision.active_set
            contraction, staleness = decision.contraction, decision.staleness
        np.concatenate(
            (
                (moment.tick, moment.time_ns, moment.wall_ns, command.source, reference.mode),
                moment.q,
                moment.v,
                command.tau,
                *forces,
                moment.com,
                com_reference,
                (math.sqrt(error.dot(error)), violation),
                moment.push,
                self._slips(moment),
                (frame.x, frame.y, frame.yaw, moment.plan_ns),
                (command.age_ns, sequence, active_set, moment.on_board_qps),
                (contraction, staleness),
            ),
            out=row[self._filled],
        )
        row[self._contact_force] = moment.contact_force
        row[self._refused] = moment.refused

    def complete(self, rows: np.ndarray) -> None:
        """Fill, in filled rows (n, width), the columns that follow from others: the loads of
        joints.
        """
        columns = self._columns
        joints = rows[:, columns["q"]][:, 7:]
        speeds = np.abs(rows[:, columns["v"]][:, 6:]) / self._robot.velocity_limit
        torques = np.abs(rows[:, columns["tau"]]) / self._torque_limit
        lowest, highest = self._robot.position_limit
        beyond = np.maximum(lowest - joints, joints - highest)
        loads = (torques.max(axis=1), beyond.max(axis=1), speeds.max(axis=1))
        rows[:, self._loads] = np.stack(loads, axis=1)

    def forget_soles(self) -> None:
        """Take the next place of each sole as the place where it was set down."""
        self._set_down = [None for _ in Foot]

    def _forces(self, decision: Decision) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the left and of the right sole."""
        f = decision.y[self._model.nv :]
        if decision.mode is ContactMode.LEFT_SUPPORT:
            return f, self._unloaded
        if decision.mode is ContactMode.RIGHT_SUPPORT:
            return self._unloaded, f
        return f[:FORCES_PER_FOOT], f[FORCES_PER_FOOT:]

    def _slips(self, moment: Moment) -> list[float]:
        """Distance in the plane of each loaded sole from where it was set down, NaN in the air."""
        loaded = moment.reference.mode.feet
        slips = []
        for k, (foot, position) in enumerate(moment.soles.items()):
            if foot not in loaded:
                self._set_down[k] = None
                slips.append(math.nan)
                continue
            x, y, _ = position.tolist()
            set_down = self._set_down[k] or (x, y)
            self._set_down[k] = set_down
            slips.append(math.hypot(x - set_down[0], y - set_down[1]))
        return slips

    def _violation(self, moment: Moment, y: np.ndarray) -> float:
        stack = self._stacks[moment.reference.mode]
        velocity, acceleration = self._model.sole_motion(
            stack.support_foot, *moment.measured, y[: self._model.nv]
        )
        return stack.contact_violation(velocity, acceleration)
