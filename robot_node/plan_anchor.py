"""Anchor of the plan: the plan goes where the standing feet are, in a joint hold and in a drift.

A reference is a place in the plan's frame (`shared/motion/plan_frame.py`). In a joint hold the
plan does not move the robot, and its feet may slide or set down elsewhere. A reference that stayed
where it was would later pull the CoM away from the feet. After `SETTLED_NS` of a hold the plan's
stance therefore follows the robot's, averaged against noise: the middle between the soles and their
mean heading.

A walk cannot go on from a standstill in the middle of a step. A hold that comes before its last
contact switch ends it: the plan's time jumps to its final stand, and the robot stands on the feet
where they are.

The base's estimate may drift. A CoM that followed a plan in a drifting world would leave the feet.
The feet of a robot in a stand do not move. If both together are measured `_APART` from where the
stand began, for `_DRIFTED_NS`, the estimate has drifted, or the feet have slipped. The plan follows
them. A fall is no drift, because it tilts the feet or moves one of them. A walk needs no such rule:
the swing foot lands where the drifting plan is.

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
# Time between two looks at the feet of a stand, and weight of the newest look in the average.
_LOOK_NS = 10_000_000
_WEIGHT = 0.1
# Looks from which the place is known where a stand begins.
_LOOKS = 20
# A drift: the distance [m] or the turn [rad] from that place, and the time for which it lasts.
_APART, _TURNED = 0.04, 0.15
_DRIFTED_NS = 300_000_000
# Feet that stand have moved by less against each other [m]. Points of each sole, 0.1 m apart, also
# show a tilt.
_SHAPE = 0.02
_POINTS = np.array(((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0)))
# A motion with more contact switches counts as endless: it has no final stand.
_MAX_SWITCHES = 10_000


class PlanAnchor:
    """The place of the plan: its `frame` in the world, and `skipped_ns` of its time.

    `skipped_ns` is negative for a plan that begins later than the task. `ended`: a joint hold has
    ended the walk. `drifts` counts how often the plan has followed a drift.
    """

    def __init__(self, model: WholeBodyModel, *, skipped_ns: int = 0) -> None:
        self.frame = PlanFrame()
        self.skipped_ns = skipped_ns
        self.ended = False
        self.drifts = 0
        self._model = model
        self._average = np.zeros(3)
        self._ticks = 0
        self._final_stand: _FinalStand | None = None
        self._stand: _Stand | None = None
        self._look_ns = 0

    def release(self) -> None:
        """Note a tick under normal control."""
        self._ticks = 0

    def stand(self, q: np.ndarray, motion: Motion, *, time_ns: int) -> None:
        """Note a tick under normal control at the measured q (nq,) in the plan, at a time of the
        task. It is one of a stand if no contact switch follows.
        """
        self._ticks = 0
        if time_ns < self._look_ns:
            return
        self._look_ns = time_ns + _LOOK_NS
        if motion.next_switch(time_ns + self.skipped_ns) is not None:
            self._stand = None
            return
        if self._stand is None:
            self._stand = _Stand()
        soles = self._model.sole_placements(q)
        points = [_POINTS.dot(soles[foot].rotation.T) + soles[foot].translation for foot in Foot]
        drift = self._stand.drift(np.concatenate(points))
        if drift is not None:
            self.frame = self.frame.followed_by(drift)
            self.drifts += 1

    def hold(self, q: np.ndarray, motion: Motion, *, time_ns: int, period_ns: int) -> None:
        """Note a held tick at the measured q (nq,) in the world, at a time of the task."""
        self._stand = None
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
        self.frame = PlanFrame.between(PlanFrame(x, y, yaw, self.frame.z), final.stance)

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


class _Stand:
    """The feet of a robot that stands under control, as points of both soles (6, 3) in the plan."""

    def __init__(self) -> None:
        self._average = np.zeros((6, 3))
        # Where the stand began.
        self._begun = self._average
        self._looks = self._away = 0

    def drift(self, points: np.ndarray) -> PlanFrame | None:
        """Look at the feet. Return the drift of the plan's frame if there is one."""
        self._looks += 1
        average = self._average
        average = average + max(1.0 / self._looks, _WEIGHT) * (points - average)
        self._average = average
        if self._looks <= _LOOKS:
            self._begun = average
            return None
        begun, now = _place(self._begun), _place(average)
        moved = math.dist((now.x, now.y, now.z), (begun.x, begun.y, begun.z))
        turned_by = abs(math.remainder(now.yaw - begun.yaw, math.tau))
        away = False
        if moved > _APART or turned_by > _TURNED:
            drift = PlanFrame.between(now, begun)
            back = (average - (drift.x, drift.y, drift.z)).dot(turned(drift.yaw))
            away = bool(np.abs(back - self._begun).max() <= _SHAPE)
        self._away = self._away + 1 if away else 0
        if self._away * _LOOK_NS < _DRIFTED_NS:
            return None
        self._average, self._away = back, 0
        return drift


def _place(points: np.ndarray) -> PlanFrame:
    """The middle between the soles and their mean heading, from points of both (6, 3)."""
    x, y, z = ((points[0] + points[3]) / 2).tolist()
    forward = points[1] - points[0] + points[4] - points[3]
    return PlanFrame(x, y, math.atan2(forward[1], forward[0]), z)


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
