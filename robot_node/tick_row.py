"""The telemetry row of one tick: what the robot truly did, beside what it was told to do."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_node.controllers import Command
from shared.robots import Foot
from shared.telemetry.schema import Schema
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack


@dataclass(frozen=True, slots=True)
class Moment:
    """A tick when its command is there and the plant has not moved yet.

    `time_ns` is that of the task, −1 before it begins; `wall_ns` that of the measurement. `q`, `v`
    is the true state, `com` and `soles` its centre of mass and sole positions in the world [m];
    `measured` what the sensors made of it. `push` is the external force on the base [N].
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
    push: np.ndarray
    on_board_qps: int
    refused: int


class TickRow:
    """Fills rows of a schema, in the order of the ticks."""

    def __init__(
        self, schema: Schema, model: WholeBodyModel, stacks: dict[ContactMode, Stack]
    ) -> None:
        self._columns = schema.slices
        self._model = model
        self._stacks = stacks
        self._set_down: dict[Foot, np.ndarray] = {}

    def fill(self, row: np.ndarray, moment: Moment, command: Command) -> None:
        """Everything but the times that the driver of the tick measures."""
        columns, reference = self._columns, moment.reference
        row[columns["tick"]] = moment.tick
        row[columns["time_ns"]] = moment.time_ns
        row[columns["wall_ns"]] = moment.wall_ns
        row[columns["source"]] = command.source
        row[columns["mode"]] = reference.mode
        row[columns["q"]] = moment.q
        row[columns["v"]] = moment.v
        row[columns["tau"]] = command.tau
        row[columns["com"]] = moment.com
        row[columns["com_reference"]] = reference.com
        error = moment.com - reference.com
        row[columns["com_error_m"]] = math.sqrt(error @ error)
        row[columns["contact_violation_m_s2"]] = np.nan
        decision = command.decision
        row[columns["contraction"]] = row[columns["staleness_rad"]] = np.nan
        row[columns["projector_sequence"]] = row[columns["active_set"]] = -1
        if decision is not None:
            forces = row[columns["f"]].reshape(len(Foot), -1)
            loaded = list(decision.mode.feet_indices)
            forces[loaded] = decision.y[self._model.nv :].reshape(len(loaded), -1)
            row[columns["contact_violation_m_s2"]] = self._violation(moment, decision.y)
            row[columns["projector_sequence"]] = decision.sequence
            row[columns["active_set"]] = decision.active_set
            row[columns["contraction"]] = decision.contraction
            row[columns["staleness_rad"]] = decision.staleness
        row[columns["push_n"]] = moment.push
        row[columns["foot_slip_m"]] = self._slips(moment)
        row[columns["projector_age_ns"]] = command.age_ns
        row[columns["on_board_qps"]] = moment.on_board_qps
        row[columns["refused"]] = moment.refused

    def _slips(self, moment: Moment) -> list[float]:
        """Distance in the plane of each loaded sole from where it was set down, NaN in the air."""
        loaded = moment.reference.mode.feet
        slips = []
        for foot, position in moment.soles.items():
            if foot not in loaded:
                self._set_down.pop(foot, None)
                slips.append(math.nan)
                continue
            moved = position[:2] - self._set_down.setdefault(foot, position[:2])
            slips.append(math.hypot(*moved))
        return slips

    def _violation(self, moment: Moment, y: np.ndarray) -> float:
        stack = self._stacks[moment.reference.mode]
        velocity, acceleration = self._model.sole_motion(
            stack.support_foot, *moment.measured, y[: self._model.nv]
        )
        return stack.contact_violation(velocity, acceleration)
