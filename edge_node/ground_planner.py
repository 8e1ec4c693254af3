"""The planner over a known ground: steps to a goal, found by a search a part at a time.

A search may take a second, and the edge has 20 ms for a plan. So each state for which a plan is due
takes the search a part further. Meanwhile the robot stands.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from edge_node.footstep_plan import MAX_STEPS, FootstepBuilder, foot_to_lift
from shared.config.settings import RunConfig
from shared.motion.footprint import Footprint
from shared.motion.footstep_search import FootstepSearch, NoFootstepsError
from shared.motion.footsteps import Step, standing_footprints
from shared.motion.ground import make_ground
from shared.motion.pendulum import dcm_of
from shared.motion.planned import SUPPORT_MODE, Plan
from shared.robots import Foot, Robot
from shared.wbc.contacts import ContactMode
from shared.wire.messages import RobotState

# Feet this near to the footprints of a way are on it [m].
_ON_WAY = 0.04
# The largest number of starts of robots whose ways are kept.
_MAX_WAYS = 16


class GroundPlanner:
    """Steps to a goal over a known ground, by the search of `shared/motion/footstep_search.py`.

    The way is searched again from where the feet are, if they are not on it. The robot stands if
    there is no way. Each start of a robot has its own way.
    """

    reacts = False

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self._build = FootstepBuilder(robot, config)
        self._ground = make_ground(config.ground, seed=config.seed)
        self._swing_height = config.walk.swing_height
        self._search = FootstepSearch(
            robot, config.walk, self._ground, config.walk.place, slopes=True
        )
        stance = standing_footprints(robot)
        self._first = _Way((stance[Foot.LEFT], stance[Foot.RIGHT]), iter([self._search.steps()]))
        self._first.found()
        self._ways: dict[int, _Way] = {}

    def plan(self, state: RobotState, *, com: np.ndarray, number: int) -> Plan | None:
        report = state.steps
        if report is None:
            return None
        way = self._ways.get(state.session, self._first)
        done = way.done(report.feet)
        in_air = state.mode is not ContactMode.DOUBLE_SUPPORT
        if done is None and not in_air:
            dcm = dcm_of(*com, omega=self._build.stance.omega)
            way, done = self._begin(state.session, report.feet, foot_to_lift(report, dcm)), 0
        if done is None or not way.found():
            return None
        left = way.steps[done:][:MAX_STEPS]
        if not left or (in_air and SUPPORT_MODE[left[0].swing_foot] is not state.mode):
            return None
        return self._build.along(
            state,
            [step.goal for step in left],
            com=com,
            number=number,
            swing_height=self._swing_height + max(step.obstacle for step in left),
        )

    def _begin(self, session: int, feet: tuple[Footprint, Footprint], first: Foot | None) -> _Way:
        """Begin a way where the feet are, and forget the oldest one if there are too many.

        `first` is the foot that lifts first, if there is a way so.
        """
        left, right = (
            dataclasses.replace(each, z=self._ground.height(each.x, each.y)) for each in feet
        )
        self._ways.pop(session, None)
        if len(self._ways) >= _MAX_WAYS:
            del self._ways[next(iter(self._ways))]
        way = self._ways[session] = _Way(
            (left, right), self._search.search((left, right), first=first)
        )
        return way


class _Way:
    """The steps from a stance (left, right) to the goal; none until the search has found them."""

    def __init__(
        self, start: tuple[Footprint, Footprint], search: Iterator[tuple[Step, ...] | None]
    ) -> None:
        self.steps: tuple[Step, ...] = ()
        self._start = start
        self._search: Iterator[tuple[Step, ...] | None] | None = search

    def found(self) -> bool:
        """Take the search a part further, if it is not over. Return whether it is."""
        if self._search is not None:
            try:
                steps = next(self._search)
            except NoFootstepsError:
                steps = ()
            if steps is None:
                return False
            self.steps, self._search = steps, None
        return True

    def done(self, at: tuple[Footprint, Footprint]) -> int | None:
        """Return how many steps lead to the present footprints; None if no part of the way does."""
        feet = {each.foot: each for each in self._start}
        places = [dict(feet)]
        for step in self.steps:
            feet[step.swing_foot] = step.goal
            places.append(dict(feet))
        for done in range(len(places) - 1, -1, -1):
            if all(
                math.dist(each.position, places[done][each.foot].position) < _ON_WAY for each in at
            ):
                return done
        return None
