"""The soles of a robot that steps by touch: planned ahead, chosen by its step law, landed.

A plan that is taken replaces the one before. What the robot has stepped on is no longer ahead, and
a step that no plan foresees voids the plan.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from shared.motion.footprint import Footprint
from shared.robots import Foot, Robot
from shared.telemetry.schema import STEP_SCHEMA, FootprintKind

# Above the ground, which has a grid at zero, and below all moving parts [m].
PRINT_HEIGHT = 0.001
# The most landed soles that are shown.
MAX_LANDED = 40
# The sole that the law has chosen is drawn over the planned one [m].
_OVER_PLAN = np.array([0.0, 0.0, 0.003])
_FEET = tuple(Foot)


class Footholds:
    """The soles after the rows that it has taken in, as outlines (5, 3) in the world [m]."""

    def __init__(self, robot: Robot) -> None:
        self._corners = sole_corners(robot)
        self._plan = -1
        self._planned: dict[int, np.ndarray] = {}
        self._chosen: list[np.ndarray] = []
        self._landed: deque[np.ndarray] = deque(maxlen=MAX_LANDED)

    @property
    def soles(self) -> dict[FootprintKind, list[np.ndarray]]:
        """The outlines of each kind, those of the plan in the order of its steps."""
        return {
            FootprintKind.PLANNED: [self._planned[place] for place in sorted(self._planned)],
            FootprintKind.CHOSEN: self._chosen,
            FootprintKind.LANDED: list(self._landed),
        }

    def take(self, rows: np.ndarray) -> None:
        """Take in rows of `STEP_SCHEMA` in their order."""
        for row in rows:
            value = {name: row[where] for name, where in STEP_SCHEMA.slices.items()}
            plan, place, kind, foot = (
                int(value[name][0]) for name in ("plan", "place", "kind", "foot")
            )
            x, y, z = value["position"].tolist()
            footprint = Footprint(_FEET[foot], x, y, float(value["yaw"][0]), z)
            sole = outline(footprint, self._corners[footprint.foot])
            if plan != self._plan:
                self._plan, self._planned = plan, {}
            if kind == FootprintKind.PLANNED:
                self._planned[place] = sole
            elif kind == FootprintKind.CHOSEN:
                self._chosen = [sole + _OVER_PLAN]
            else:
                self._landed.append(sole)
                self._chosen = []
                ahead = {at: each for at, each in self._planned.items() if at > place}
                self._planned = ahead


def sole_corners(robot: Robot) -> dict[Foot, np.ndarray]:
    """Return the corners of each sole in its frame, (5, 2) [m]; the first one comes again."""
    return {sole.side: sole.corners()[[0, 1, 3, 2, 0], :2] for sole in robot.soles}


def outline(footprint: Footprint, corners: np.ndarray) -> np.ndarray:
    """Return a sole with these corners (5, 2) on a footprint, (5, 3) in the world [m]."""
    height = footprint.z + PRINT_HEIGHT
    return np.array([[*footprint.to_world((x, y)), height] for x, y in corners])
