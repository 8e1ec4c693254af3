"""The footholds beside a foot that a search tries: a grid of (forward, sideways, turn) and its
costs, and the places that the legs reach.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from shared.config.step_settings import WalkConfig
from shared.motion.footprint import Footprint
from shared.motion.footsteps import SOLE_CLEARANCE, narrowest
from shared.robots import Foot, Robot
from shared.robots.standing import leg_length

# Grid of the footholds beside a foot [m, rad].
FORWARD_GRID, SIDEWAYS, TURNS = 0.03, (0.0, 0.04, 0.1), (-0.13, 0.0, 0.26)
_BACKWARD = 0.12
# Highest climb and descent of a step [m].
CLIMB = 0.12


@dataclass(frozen=True)
class Actions:
    """The grid of footholds of one foot beside the other one.

    `offsets` (n,) are x + iy from the other foot, in its frame. `turn` (n,) are indices of `turns`
    (n_t,), the turns to the left [rad]. `cost` (n,) is the cost beyond that of a step. `half` (n,)
    is the horizontal part of a leg while both feet are down [m].
    """

    offsets: np.ndarray
    turn: np.ndarray
    turns: np.ndarray
    cost: np.ndarray
    half: np.ndarray


class FootholdReach:
    """The places of a foot beside the other one that the legs reach."""

    def __init__(self, robot: Robot, config: WalkConfig, width: float) -> None:
        self._robot = robot
        self._width = width
        self._longest = abs(config.step_length)
        self._stretched, height = leg_length(robot)
        self._height = height - config.com_lowering

    def actions(self, foot: Foot) -> Actions:
        """Grid of footholds for a foot beside the other one."""
        longest = self._longest
        count = math.floor(longest / FORWARD_GRID + 1e-9)
        ahead = [k * FORWARD_GRID for k in range(-round(_BACKWARD / FORWARD_GRID), count + 1)]
        if longest - ahead[-1] > 1e-6:
            ahead.append(longest)
        rows = []
        # Sideways and turn are positive outward.
        for forward, wider, (index, turn) in itertools.product(ahead, SIDEWAYS, enumerate(TURNS)):
            sideways = max(self._width, self._least(turn)) + wider
            extra = 2.0 * wider + abs(turn) + (0.1 if forward < 0.0 else 0.0)
            rows.append((forward, sideways, index, extra))
        # The longest step comes first, because the search takes the first of two equally good ways.
        forward, sideways, turn, extra = np.array(sorted(rows, key=lambda row: -row[0])).T
        side = 1.0 if foot is Foot.LEFT else -1.0
        return Actions(
            offsets=forward + 1j * side * sideways,
            turn=turn.astype(int),
            turns=side * np.array(TURNS),
            cost=extra,
            half=self._half(forward, sideways),
        )

    def within(self, half: np.ndarray, climb: np.ndarray) -> np.ndarray:
        """Return whether the legs reach places (n,), with `Actions.half` (n,) and climbs (n,)."""
        # The hips are above the middle between the feet, and in the middle of a climb.
        reached: np.ndarray = np.hypot(half, self._height + climb / 2) <= self._stretched
        return reached & (climb <= CLIMB)

    def holds(self, support: Footprint, goal: Footprint) -> bool:
        """Return whether a step reaches any of the places, for example that of the goal."""
        x, y = (goal.position - support.position).tolist()
        c, s = math.cos(support.yaw), math.sin(support.yaw)
        forward, sideways = c * x + s * y, -s * x + c * y
        turn = math.remainder(goal.yaw - support.yaw, math.tau)
        if goal.foot is Foot.RIGHT:
            sideways, turn = -sideways, -turn
        if not TURNS[0] <= turn <= TURNS[-1] or not -_BACKWARD <= forward <= self._longest:
            return False
        if not self._least(turn) <= sideways <= self._width + SIDEWAYS[-1]:
            return False
        half = self._half(np.array([forward]), np.array([sideways]))
        return bool(self.within(half, np.array([abs(goal.z - support.z)]))[0])

    def _half(self, forward: np.ndarray, sideways: np.ndarray) -> np.ndarray:
        half: np.ndarray = np.hypot(forward, sideways - self._width) / 2
        return half

    def _least(self, turn: float) -> float:
        """Least distance of the feet side by side [m]."""
        return narrowest(self._robot, turn=abs(turn)) + SOLE_CLEARANCE
