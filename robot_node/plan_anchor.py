"""Anchor of the plan in a joint hold: the plan goes where the standing feet are.

A reference is a place in the plan's frame (`shared/motion/plan_frame.py`). In a joint hold the
plan does not move the robot, and its feet may slide or set down elsewhere. A reference that stayed
where it was would later pull the CoM away from the feet. After `SETTLED_NS` of a hold the plan's
stance therefore follows the robot's, averaged against noise: the middle between the soles and their
mean heading.

A walk cannot go on from a standstill in the middle of a step. A hold that comes before its last
contact switch ends it: the plan's time jumps to its final stand, and the robot stands on the feet
where they are.

A robot that steps by touch needs no anchor, because its references are over its measured feet
(`robot_node/stepping.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_node.plant import world_from_base
from shared.motion.plan_frame import PlanFrame
from shared.robots import Foot
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Motion, Reference, turned

SETTLED_NS = 100_000_000
"""The hold after which the robot counts as standing still. A shorter one, as at a contact switch
without a projector, leaves the plan alone."""
# Weight of the newest tick in the average: a time constant of 50 ms.
_AVERAGE = 0.02
# After its last contact switch the CoM of a plan comes to rest within this time.
_REST_NS = 10_000_000_000
# A motion with more contact switches counts as endless: it has no final stand.
_MAX_SWITCHES = 10_000


class PlanAnchor:
    """The place of the plan: its `frame` in the world, and `skipped_ns` of its time.

    `skipped_ns` is negative for a plan that begins later than the task. `ended`: a joint hold has
    ended the walk.
    """

    def __init__(self, model: WholeBodyModel, *, skipped_ns: int = 0) -> None:
        self.frame = PlanFrame()
        self.skipped_ns = skipped_ns
        self.ended = False
        self._model = model
        self._average = np.zeros(3)
        self._ticks = 0
        self._final_stand: _FinalStand | None = None

    def release(self) -> None:
        """Note a tick under normal control."""
        self._ticks = 0

    def hold(self, q: np.ndarray, motion: Motion, *, time_ns: int, period_ns: int) -> None:
        """Note a held tick at the measured q (nq,) in the world, at a time of the task."""
        stance = self._stance(q)
        error = np.array((stance.x, stance.y, stance.yaw)) - self._average
        error[2] = math.remainder(error[2], math.tau)
        self._ticks += 1
        self._average += max(1.0 / self._ticks, _AVERAGE) * error
        if self._ticks * period_ns < SETTLED_NS:
            return
        final = self._final_stand_of(motion)
        if final.last_switch_ns is not None and time_ns + self.skipped_ns < final.last_switch_ns:
            self.skipped_ns = final.last_switch_ns + _REST_NS - time_ns
            self.ended = True
        x, y, yaw = self._average.tolist()
        self.frame = PlanFrame.between(PlanFrame(x, y, yaw), final.stance)

    def _final_stand_of(self, motion: Motion) -> _FinalStand:
        """Return the final stand of a motion, computed once for each."""
        final = self._final_stand
        if final is None or final.motion is not motion:
            stance = self._stance(self._model.robot.q_standing)
            last_ns = _last_switch_ns(motion)
            if last_ns is not None:
                stance = self._stance_below(motion.reference(last_ns + _REST_NS), stance)
            final = self._final_stand = _FinalStand(motion, last_ns, stance)
        return final

    def _stance(self, q: np.ndarray) -> PlanFrame:
        """Middle between the soles and their mean heading, at q (nq,)."""
        soles = self._model.sole_placements(q)
        left, right = (soles[foot] for foot in Foot)
        x, y, _ = ((left.translation + right.translation) / 2).tolist()
        forward = left.rotation[:, 0] + right.rotation[:, 0]
        return PlanFrame(x, y, math.atan2(forward[1], forward[0]))

    def _stance_below(self, reference: Reference, standing: PlanFrame) -> PlanFrame:
        """Stance below a reference at rest, placed as `standing` is below the standing robot."""
        q = self._model.robot.q_standing
        com, _ = self._model.com_and_soles(q)
        base_turn = reference.world_from_base.dot(world_from_base(q).T)
        yaw = math.atan2(base_turn[1, 0], base_turn[0, 0])
        offset = turned(yaw).dot(com - (standing.x, standing.y, 0.0))
        x, y, _ = (reference.com - offset).tolist()
        return PlanFrame(x, y, standing.yaw + yaw)


@dataclass(frozen=True)
class _FinalStand:
    """The stance in which a motion ends, and the time of its last contact switch, if it has one."""

    motion: Motion
    last_switch_ns: int | None
    stance: PlanFrame


def _last_switch_ns(motion: Motion) -> int | None:
    """Return the time of a motion's last contact switch; None without one, or if the switches do
    not end.
    """
    last_ns, switch_ns = None, motion.next_switch(0)
    for _ in range(_MAX_SWITCHES):
        if switch_ns is None:
            return last_ns
        last_ns, switch_ns = switch_ns, motion.next_switch(switch_ns)
    return None
