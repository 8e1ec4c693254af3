"""The telemetry rows of footprints: planned by the edge, chosen by the step law, landed.

The contact clock is compared with itself a tick before. A new plan gives a row for each of its
footprints, a foothold that the law has chosen or moved one, and a foot that has landed one.
"""

from __future__ import annotations

import math

import numpy as np

from robot_node.stepping import ContactClock
from robot_node.tick_row import Moment
from shared.motion.footprint import Footprint
from shared.motion.planned import Plan
from shared.robots import Foot
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import FootprintKind
from shared.wbc.model import WholeBodyModel

# A foothold that moves less than this gives no other row [m].
_MOVED = 0.005
_NO_PLAN = (-1, -1)
_NUMBER = {foot: number for number, foot in enumerate(Foot)}


class StepRows:
    """Fills rows of `STEP_SCHEMA`, in the order of the ticks."""

    def __init__(self, model: WholeBodyModel) -> None:
        self._model = model
        self._clock: ContactClock | None = None
        self._plan: Plan | None = None
        self._in_air: Foot | None = None
        self._chosen: Footprint | None = None
        self._phase = 0
        # The number of the plan, and the place of the present phase in it.
        self._step = _NO_PLAN
        self._filled = False

    def fill(self, log: RowLog, moment: Moment, clock: ContactClock) -> None:
        """Fill the rows of a tick, if it has any, and hand them over."""
        self._filled = False
        if clock is not self._clock:
            # The robot begins, or begins anew. It stands, with neither a plan nor a law.
            self._clock, self._plan, self._chosen = clock, None, None
            self._step = _NO_PLAN
            for foot in Foot:
                self._fill_landed(log, moment, foot)
        elif clock.phase != self._phase and self._in_air is not None:
            self._fill_landed(log, moment, self._in_air)
            self._chosen = None
        plan, path = clock.plan, clock.swing_path
        if plan is not None and plan is not self._plan:
            begin_ns = moment.time_ns - clock.phase_ns - plan.phases[0].begin_ns
            for place, phase in enumerate(plan.phases):
                if phase.footprint is not None:
                    self._fill(
                        log,
                        moment,
                        FootprintKind.PLANNED,
                        (plan.number, place),
                        phase.footprint,
                        begin_ns + phase.end_ns,
                    )
        self._plan, self._phase = plan, clock.phase
        self._step = _NO_PLAN if plan is None else (plan.number, clock.place)
        self._in_air = None if path is None else path.goal.foot
        chosen = clock.chosen
        if path is not None and chosen is not None and self._moved(chosen):
            self._chosen = chosen
            landing_ns = moment.time_ns - moment.plan_ns + round(path.end * 1e9)
            self._fill(log, moment, FootprintKind.CHOSEN, self._step, chosen, landing_ns)
        if self._filled:
            log.hand_over()

    def _moved(self, chosen: Footprint) -> bool:
        last = self._chosen
        if last is None:
            return True
        way = (chosen.x - last.x, chosen.y - last.y, chosen.z - last.z)
        return math.hypot(*way) > _MOVED

    def _fill_landed(self, log: RowLog, moment: Moment, foot: Foot) -> None:
        """Fill the row of a sole that bears, at its true place in the world."""
        placement = self._model.sole_placements(moment.q)[foot]
        x, y, z = placement.translation.tolist()
        yaw = math.atan2(placement.rotation[1, 0], placement.rotation[0, 0])
        row = (*self._step, _NUMBER[foot], x, y, z, yaw, moment.time_ns)
        self._write(log, moment, FootprintKind.LANDED, row)

    def _fill(
        self,
        log: RowLog,
        moment: Moment,
        kind: FootprintKind,
        step: tuple[int, int],
        goal: Footprint,
        landing_ns: int,
    ) -> None:
        """Fill the row of a footprint in the plan's frame, which is put into the world."""
        frame = moment.plan_frame
        x, y, z = frame.point_in_world(np.array((goal.x, goal.y, goal.z))).tolist()
        row = (*step, _NUMBER[goal.foot], x, y, z, goal.yaw + frame.yaw, landing_ns)
        self._write(log, moment, kind, row)

    def _write(
        self, log: RowLog, moment: Moment, kind: FootprintKind, row: tuple[float, ...]
    ) -> None:
        # All columns, in their order.
        log.row()[:] = (moment.wall_ns, moment.time_ns, kind, *row)
        self._filled = True
