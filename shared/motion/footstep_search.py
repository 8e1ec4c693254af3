"""Footsteps to a goal over a known ground, by weighted A* over footholds.

A state is the foot that was placed last. Its successors are the footholds of the other foot on a
grid of (forward, sideways, turn) beside it. A foothold counts if the ground under the sole, and a
margin around it, is level and allowed, and if the legs reach it. The cost of a step is 1, and a
little more for steps sideways, turns and climbs. The estimate of the steps to the goal is the
smaller one of two ways: turn, walk and turn, or walk sideways too. On ground that is not uniform,
the estimate uses the way of a point on a coarse grid around walls, holes and forbidden places.

The search checks the ground under a foothold coarsely when it lists the successors, and closely
when it expands the foothold. The search keeps at most `MAX_EXPANSIONS` states with their
successors, and is a function of its arguments only. Method: Hornung, Dornbush, Likhachev and
Bennewitz 2012, "Anytime search-based footstep planning with suboptimality bounds", without the
anytime part.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.config.quantities import Goal
from shared.config.settings import WalkConfig
from shared.errors import ConfigError
from shared.motion.footprint import Footprint
from shared.motion.footsteps import (
    SOLE_CLEARANCE,
    Step,
    narrowest,
    standing_footprints,
)
from shared.motion.ground import Ground, Patch
from shared.robots import Foot, Robot
from shared.robots.standing import leg_length

# Points in the plane are complex numbers x + iy here, so that a turn is a product. A search gives
# up after this number of states.
MAX_EXPANSIONS = 1000
# Grid of the footholds beside a foot [m, rad].
_FORWARD_GRID, _SIDEWAYS, _TURNS = 0.03, (0.0, 0.04, 0.1), (-0.13, 0.0, 0.26)
_BACKWARD = 0.12
# Highest climb and descent of a step, and highest ground that a foot passes over [m].
_CLIMB, _OVER = 0.12, 0.12
# Fastest swing, on the average [m/s].
_FASTEST = 0.5
# Heights of level ground differ by less [m].
_TOLERANCE = 3e-3
# Cells of the height table, and the distance of points of a sole [m].
_CELL, _SPACING = 0.01, 0.02
# Least distance of a landing foot from higher ground ahead and behind, beside the 1 cm from any
# edge [m].
_AHEAD = 0.02
# Two states are the same within this [m, rad].
_SAME, _SAME_BEHIND, _SAME_TURN = 0.04, 0.12, 0.12
# Edge of a coarse cell in cells, and the factor on the length of a way across a wall or a hole. A
# way that is longer than the direct one by the last factor goes round an obstacle.
_COARSE, _WALL, _ROUND = 4, 4.0, 1.2
# Half of the width of a stance, in coarse cells.
_HALF_STANCE = 4
# Weight of the estimate: larger finds a way sooner, and a longer one.
_GREED = 2.5
# The margin of the table around start and goal [m].
_AROUND = 0.6
# The largest distance of the feet from a goal without level ground [m].
_NEAR, _NEAR_GRID = 0.16, 0.02
# The height of a place where no foot may be set [m]; the rim of the table in cells.
_NOWHERE, _RIM = -3.0, 40


class NoFootstepsError(ConfigError):
    """No sequence of steps to the goal was found."""


def find_footsteps(
    robot: Robot,
    config: WalkConfig,
    ground: Ground,
    goal: Goal,
    *,
    start: tuple[Footprint, Footprint] | None = None,
    forbidden: Sequence[Patch] = (),
) -> tuple[Step, ...]:
    """Find the steps from a stance (left, right; None: standing) to the goal.

    `forbidden` are further places where no foot may be set. Raise `NoFootstepsError` with the
    reason if there is no way, or if the search gives up.
    """
    if start is None:
        stance = standing_footprints(robot)
        start = stance[Foot.LEFT], stance[Foot.RIGHT]
    table = _Heights(ground, forbidden, start, goal)
    search = _Search(robot, config, table, goal)
    return search.run(start)


class _Heights:
    """Heights of the ground in cells of 1 cm, the lowest and highest within a cell around each."""

    def __init__(
        self,
        ground: Ground,
        forbidden: Sequence[Patch],
        start: tuple[Footprint, Footprint],
        goal: Goal,
    ) -> None:
        points = np.array([(start[0].x, start[0].y), (start[1].x, start[1].y), (goal.x, goal.y)])
        self._low = np.floor((points.min(axis=0) - _AROUND) / _CELL).astype(int)
        shape = np.ceil((points.max(axis=0) + _AROUND) / _CELL).astype(int) - self._low
        table = np.zeros(shape)
        closed = np.zeros(shape, dtype=bool)
        for patch in ground.patches:
            rows, columns = self._cells(patch.x, 0, shape), self._cells(patch.y, 1, shape)
            x = (np.arange(rows.start, rows.stop) + self._low[0] + 0.5) * _CELL
            table[rows, columns] = (patch.z + patch.rise * (x - patch.x[0]))[:, None]
            closed[rows, columns] = not patch.allowed
        for patch in forbidden:
            closed[self._cells(patch.x, 0, shape), self._cells(patch.y, 1, shape)] = True
        # Nothing is level with a place where no foot may be.
        lowest = np.where(closed, _NOWHERE, table)
        self.highest = _spread(table, np.maximum).ravel()
        self.lowest = _spread(lowest, np.minimum).ravel()
        self._last = shape - 1
        self.uniform = bool(np.ptp(lowest) == 0.0)
        # Whole tenths of a millimetre, with a rim as wide as a sole, for `level`.
        self._fine = [
            np.pad((each * 1e4).astype(np.int16), _RIM, "edge") for each in (table, lowest)
        ]
        self._level: dict[tuple[Foot, float], np.ndarray] = {}
        self._ways = None if self.uniform else self._ways_to(complex(goal.x, goal.y))

    def detour(self, places: np.ndarray, direct: np.ndarray) -> np.ndarray:
        """Return the way from places (n,) to the goal by `direct` (n,) [m], at least 1."""
        if self._ways is None:
            return np.ones(len(places))
        columns = -(-int(self._last[1] + 1) // _COARSE)
        cells = self.cells_of(places)
        row, column = np.divmod(cells, self._last[1] + 1)
        ways = self._ways[row // _COARSE * columns + column // _COARSE]
        detour: np.ndarray = np.maximum(ways / np.maximum(direct, _COARSE * _CELL), 1.0)
        return detour

    def _ways_to(self, goal: complex) -> np.ndarray:
        """Ways from the cells of a coarse grid to the goal [m], raveled."""
        # Imported here: it takes long, and flat ground does not need it.
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        rows, columns = shape = self._last + 1
        steps = (self.highest - self.lowest).reshape(rows, columns)
        length = np.where(steps > _CLIMB, _WALL, 1.0)
        padded = np.pad(length, [(0, -int(n) % _COARSE) for n in shape], "edge")
        n, m = padded.shape[0] // _COARSE, padded.shape[1] // _COARSE
        coarse = padded.reshape(n, _COARSE, m, _COARSE).max(axis=(1, 3)) * _COARSE * _CELL
        # Both feet pass an obstacle on one side of it.
        for _ in range(_HALF_STANCE):
            coarse = _spread(coarse, np.maximum)
        number = np.arange(n * m).reshape(n, m)
        edges = []
        for one, other, long in (
            ((slice(1, None), slice(None)), (slice(-1), slice(None)), 1.0),
            ((slice(None), slice(1, None)), (slice(None), slice(-1)), 1.0),
            ((slice(1, None), slice(1, None)), (slice(-1), slice(-1)), math.sqrt(2.0)),
            ((slice(1, None), slice(-1)), (slice(-1), slice(1, None)), math.sqrt(2.0)),
        ):
            way = long * (coarse[one] + coarse[other]).ravel() / 2
            edges.append((way, number[one].ravel(), number[other].ravel()))
        ways, begin, end = (np.concatenate(each) for each in zip(*edges, strict=True))
        graph = coo_array((ways, (begin, end)), shape=(n * m, n * m)).tocsr()
        row, column = np.divmod(self.cells_of(np.array([goal]))[0], columns)
        found: np.ndarray = dijkstra(
            graph, directed=False, indices=row // _COARSE * m + column // _COARSE
        )
        return found

    def level(self, foot: Foot, sole: np.ndarray, yaw: float) -> np.ndarray | None:
        """Return, by cell, whether the ground is level under the points (n,) of a turned sole
        there.

        It is true wherever `_Search` finds the ground level with a margin of 1 cm. None:
        everywhere.
        """
        if self.uniform:
            return None
        key = foot, round(yaw, 6)
        if key not in self._level:
            offsets = np.rint(_placed(sole, np.zeros(1), np.array([yaw]))[0] / _CELL)
            highest, lowest = self._fine
            rows, columns = self._last + 1
            top = bottom = highest[_RIM : _RIM + rows, _RIM : _RIM + columns]
            for offset in offsets.tolist():
                i, j = int(offset.real) + _RIM, int(offset.imag) + _RIM
                top = np.maximum(top, highest[i : i + rows, j : j + columns])
                bottom = np.minimum(bottom, lowest[i : i + rows, j : j + columns])
            self._level[key] = (top <= bottom + round(2e4 * _TOLERANCE)).ravel()
        return self._level[key]

    def cells_of(self, points: np.ndarray) -> np.ndarray:
        """Cells of points, as indices of a raveled table; one outside has the nearest cell."""
        rows, columns = (
            np.minimum(np.maximum(np.floor(x * (1.0 / _CELL)) - low, 0), last)
            for x, low, last in zip((points.real, points.imag), self._low, self._last, strict=True)
        )
        cells: np.ndarray = (rows * (self._last[1] + 1) + columns).astype(int)
        return cells

    def _cells(self, span: tuple[float, float], axis: int, shape: np.ndarray) -> slice:
        """Cells whose middle is in a span, within the table."""
        begin, end = (
            min(max(math.ceil(x / _CELL - 0.5) - int(self._low[axis]), 0), int(shape[axis]))
            for x in span
        )
        return slice(begin, end)


def _spread(table: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Extreme of each cell and its eight neighbours."""
    for axis in (0, 1):
        table = np.moveaxis(table, axis, 0)
        spread = table.copy()
        extreme(spread[1:], table[:-1], out=spread[1:])
        extreme(spread[:-1], table[1:], out=spread[:-1])
        table = np.moveaxis(spread, 0, axis)
    return table


@dataclass(frozen=True)
class _Node:
    """A placed foot. `arrived`: this foot is in its place at the goal. `done`: both feet are."""

    cost: float
    placed: Footprint
    parent: _Node | None
    arrived: bool = False
    done: bool = False

    @property
    def start(self) -> Footprint | None:
        """The earlier footprint of the same foot; None at the beginning."""
        before = None if self.parent is None else self.parent.parent
        return None if before is None else before.placed


# An entry of the queue: its rank and number, then the arguments of a node.
_Entry = tuple[float, int, float, Footprint, _Node, bool, bool]


class _Search:
    """The search of one robot over one table of heights."""

    def __init__(self, robot: Robot, config: WalkConfig, table: _Heights, goal: Goal) -> None:
        stance = standing_footprints(robot)
        self._width = config.step_width or stance[Foot.LEFT].y - stance[Foot.RIGHT].y
        self._middle_x = (stance[Foot.LEFT].x + stance[Foot.RIGHT].x) / 2
        self._longest = abs(config.step_length)
        if self._longest < _FORWARD_GRID:
            raise ConfigError(
                f"walk.step_length: expected at least {_FORWARD_GRID:g} m to go to a goal, got "
                f"{config.step_length:g}"
            )
        self._longest_swing = _FASTEST * (config.step_duration - config.double_support)
        # The mean way of a step, if each foot swings past the other one.
        self._advance = min(self._longest, self._longest_swing / 2)
        self._table = table
        self._goal = goal
        self._reach = _Reach(robot, config, self._width)
        self._actions = self._reach.actions()
        soles = {sole.side: sole for sole in robot.soles}
        self._soles = {side: _grid(sole.x, sole.y) for side, sole in soles.items()}
        # Two lines of points ahead of the sole, and two behind it.
        self._ahead = {
            side: np.concatenate(
                [
                    _grid((sole.x[0] - _AHEAD,) * 2, sole.y),
                    _grid((sole.x[1] + _AHEAD,) * 2, sole.y),
                ]
            )
            for side, sole in soles.items()
        }
        self._coarse = {
            side: _grid(sole.x, sole.y, spacing=2 * _SPACING) for side, sole in soles.items()
        }
        self._queue: list[_Entry] = []
        self._numbers = itertools.count()
        self._known: set[tuple[object, ...]] = set()

    def run(self, start: tuple[Footprint, Footprint]) -> tuple[Step, ...]:
        """Return the steps from a stance (left, right)."""
        goals = self._stance_at_goal()
        stances = [start, start[::-1]]
        # If both ways are as good, the foot on the side of the goal goes first.
        if self._goal.y > 0.0 or (self._goal.y == 0.0 and self._goal.yaw > 0.0):
            stances.reverse()
        for support, swing in stances:
            node = _Node(0.0, support, _Node(0.0, swing, None))
            self._expand(node, goals)
        expansions = looked_at = 0
        while self._queue and expansions < MAX_EXPANSIONS and looked_at < 4 * MAX_EXPANSIONS:
            node = _Node(*heapq.heappop(self._queue)[2:])
            key = (*_cell(node.placed), *self._cell_behind(node), node.arrived, node.done)
            if key in self._known:
                continue
            looked_at += 1
            if not self._can_be_made(node):
                continue
            if node.done:
                return tuple(self._steps(node))
            self._known.add(key)
            expansions += 1
            self._expand(node, goals)
        raise NoFootstepsError(
            f"goal: found no way to {self._goal.x:g}, {self._goal.y:g} over this ground in "
            f"{expansions} footholds; try a larger walk.step_length or walk.com_lowering, or a "
            "nearer goal"
        )

    def _stance_at_goal(self) -> dict[Foot, Footprint]:
        """Footprints on level ground nearest to the goal."""
        goal = self._goal
        steps = np.arange(-_NEAR, _NEAR + 1e-9, _NEAR_GRID)
        # Symmetric, so that the nearest of a goal to the left mirrors that of one to the right.
        off = (steps[:, None] + 1j * steps).ravel() if not self._table.uniform else np.zeros(1)
        off = off[np.lexsort((np.abs(off.imag), np.round(np.abs(off), 9)))]
        turn = complex(math.cos(goal.yaw), math.sin(goal.yaw))
        # As in standing, the place of the goal is below the base.
        places = {
            foot: complex(goal.x, goal.y)
            + turn * (off + complex(self._middle_x, side * self._width / 2))
            for foot, side in ((Foot.LEFT, 1.0), (Foot.RIGHT, -1.0))
        }
        yaw = np.full(len(off), goal.yaw)
        found = {foot: self._footholds(foot, at, yaw) for foot, at in places.items()}
        apart = np.abs(found[Foot.LEFT][1] - found[Foot.RIGHT][1])
        both = found[Foot.LEFT][0] & found[Foot.RIGHT][0] & (apart <= _CLIMB / 2)
        if not both.any():
            raise NoFootstepsError(
                f"goal: expected level ground for both feet within {_NEAR:g} m of "
                f"{goal.x:g}, {goal.y:g}, found none; try another goal"
            )
        k = int(np.argmax(both))
        return {
            foot: Footprint(foot, at[k].real, at[k].imag, goal.yaw, float(found[foot][1][k]))
            for foot, at in places.items()
        }

    def _expand(self, node: _Node, goals: dict[Foot, Footprint]) -> None:
        """Queue the footholds of the other foot that are within reach of a node."""
        support = node.placed
        foot = Foot.RIGHT if support.foot is Foot.LEFT else Foot.LEFT
        last = goals[foot]
        swing = abs(complex(last.x, last.y) - self._swings_from(node))
        if swing <= self._longest_swing and self._reach.holds(support, last):
            rank = node.cost + 1.0 + _GREED * (not node.arrived)
            self._push(rank, node.cost + 1.0, last, node, arrived=True, done=node.arrived)
        side = 1.0 if foot is Foot.LEFT else -1.0
        forward, sideways, turn, extra = self._actions.T
        heading = complex(math.cos(support.yaw), math.sin(support.yaw))
        places = complex(support.x, support.y) + heading * (forward + 1j * side * sideways)
        yaw = support.yaw + side * turn
        cells = self._table.cells_of(places)
        z = self._table.highest[cells]
        climb = np.abs(z - support.z)
        near = self._reach.within(forward, sideways, climb)
        near &= np.abs(places - self._swings_from(node)) <= self._longest_swing
        for each in self._reach.turns:
            level = self._table.level(foot, self._coarse[foot], support.yaw + side * each)
            if level is not None:
                near &= (turn != each) | level[cells]
        costs = node.cost + 1.0 + extra + 2.0 * climb
        ranks = costs + _GREED * self._estimate(foot, places, yaw)
        for rank, cost, place, angle, height in zip(
            *(each[near].tolist() for each in (ranks, costs, places, yaw, z)), strict=True
        ):
            placed = Footprint(foot, place.real, place.imag, angle, height)
            self._push(rank, cost, placed, node)

    def _cell_behind(self, node: _Node) -> tuple[int, int]:
        """Coarse cell of the other foot, which decides how far that foot can swing."""
        other = self._swings_from(node)
        return round(other.real / _SAME_BEHIND), round(other.imag / _SAME_BEHIND)

    @staticmethod
    def _swings_from(node: _Node) -> complex:
        """Place from which the other foot swings after this one was placed."""
        other = node.placed if node.parent is None else node.parent.placed
        return complex(other.x, other.y)

    def _push(
        self,
        rank: float,
        cost: float,
        placed: Footprint,
        parent: _Node,
        *,
        arrived: bool = False,
        done: bool = False,
    ) -> None:
        entry = (rank, next(self._numbers), cost, placed, parent, arrived, done)
        heapq.heappush(self._queue, entry)

    def _can_be_made(self, node: _Node) -> bool:
        """Return whether the ground is level under a foot, and low enough on its way there."""
        at, start = node.placed, node.start
        if self._table.uniform:
            return True
        level, _ = self._footholds(at.foot, np.array([complex(at.x, at.y)]), np.array([at.yaw]))
        if not level[0] or start is None:
            return bool(level[0])
        return self._highest_between(start, at) - max(start.z, at.z) <= _OVER

    def _footholds(
        self, foot: Foot, places: np.ndarray, yaw: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return whether the ground is level under soles at places (n,) and headings (n,), and its
        heights (n,) [m].
        """
        table = self._table
        z = table.highest[table.cells_of(places)]
        cells = table.cells_of(_placed(self._soles[foot], places, yaw))
        under = table.lowest[cells]
        ahead = table.highest[table.cells_of(_placed(self._ahead[foot], places, yaw))]
        highest = np.maximum(table.highest[cells].max(axis=1), ahead.max(axis=1))
        level = (under.min(axis=1) >= z - _TOLERANCE) & (highest <= z + _TOLERANCE)
        return level, z

    def _estimate(self, foot: Foot, places: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Steps from placed feet (n,), with headings (n,), to the goal, (n,)."""
        inward = -self._width / 2 if foot is Foot.LEFT else self._width / 2
        heading = np.exp(1j * yaw)
        base = places + heading * complex(-self._middle_x, inward)
        # The way in the frame of the foot.
        way = (complex(self._goal.x, self._goal.y) - base) * heading.conj()
        forward, sideways = np.abs(way.real), np.abs(way.imag)
        towards = np.angle(way)
        turn = np.remainder(self._goal.yaw - yaw + math.pi, math.tau) - math.pi
        last = np.remainder(turn - towards + math.pi, math.tau) - math.pi
        turns, turn = np.abs(towards) + np.abs(last), np.abs(turn)
        turning = (_TURNS[2] - _TURNS[0]) / 2
        distance = np.abs(way)
        detour = self._table.detour(base, distance)
        # Round an obstacle the direction of the goal means nothing.
        turns = np.where(detour > _ROUND, turn, turns)
        straight = detour * distance / self._advance + turns / turning
        across = forward / self._advance + 2.0 * sideways / _SIDEWAYS[-1] + turn / turning
        estimate: np.ndarray = np.minimum(straight, detour * across)
        return estimate

    def _highest_between(self, start: Footprint, goal: Footprint) -> float:
        """Highest ground under a sole on its straight way between two footprints."""
        begin, way = complex(start.x, start.y), complex(goal.x - start.x, goal.y - start.y)
        share = np.linspace(0.0, 1.0, 2 + math.ceil(abs(way) / 0.05))
        places = begin + share * way
        yaw = start.yaw + share * math.remainder(goal.yaw - start.yaw, math.tau)
        points = _placed(self._soles[goal.foot], places, yaw)
        return float(self._table.highest[self._table.cells_of(points)].max())

    def _steps(self, node: _Node) -> list[Step]:
        steps = []
        while (start := node.start) is not None and node.parent is not None:
            highest = self._highest_between(start, node.placed)
            steps.append(Step(node.parent.placed, start, node.placed, highest))
            node = node.parent
        return steps[::-1]


def _cell(placed: Footprint) -> tuple[object, ...]:
    """Cell of a footprint. The search keeps one state per cell."""
    x, y, turn = placed.x / _SAME, placed.y / _SAME, placed.yaw / _SAME_TURN
    return placed.foot, round(x), round(y), round(turn)


class _Reach:
    """The places of a foot beside the other one that the legs reach."""

    turns = _TURNS

    def __init__(self, robot: Robot, config: WalkConfig, width: float) -> None:
        self._robot = robot
        self._width = width
        self._longest = abs(config.step_length)
        self._stretched, height = leg_length(robot)
        self._height = height - config.com_lowering

    def actions(self) -> np.ndarray:
        """Grid of footholds: forward, sideways from the other foot, turn, extra cost, (n, 4).

        Sideways and turn are positive outward.
        """
        longest = self._longest
        count = math.floor(longest / _FORWARD_GRID + 1e-9)
        ahead = [k * _FORWARD_GRID for k in range(-round(_BACKWARD / _FORWARD_GRID), count + 1)]
        if longest - ahead[-1] > 1e-6:
            ahead.append(longest)
        rows = []
        for forward, wider, turn in itertools.product(ahead, _SIDEWAYS, _TURNS):
            sideways = max(self._width, self._least(turn)) + wider
            extra = 2.0 * wider + abs(turn) + (0.1 if forward < 0.0 else 0.0)
            rows.append((forward, sideways, turn, extra))
        # The longest step comes first, because the search takes the first of two equally good ways.
        return np.array(sorted(rows, key=lambda row: -row[0]))

    def _least(self, turn: float) -> float:
        """Least distance of the feet side by side [m]."""
        return narrowest(self._robot, turn=abs(turn)) + SOLE_CLEARANCE

    def within(self, forward: np.ndarray, sideways: np.ndarray, climb: np.ndarray) -> np.ndarray:
        """Return whether the legs reach places (n,), in the frame of the support foot.

        The hips are above the middle between the feet, and in the middle of a climb.
        """
        half = np.hypot(forward, sideways - self._width) / 2
        holds: np.ndarray = np.hypot(half, self._height + climb / 2) <= self._stretched
        return holds & (climb <= _CLIMB)

    def holds(self, support: Footprint, goal: Footprint) -> bool:
        """Return whether a step reaches any of the places, for example that of the goal."""
        x, y = (goal.position - support.position).tolist()
        c, s = math.cos(support.yaw), math.sin(support.yaw)
        forward, sideways = c * x + s * y, -s * x + c * y
        turn = math.remainder(goal.yaw - support.yaw, math.tau)
        if goal.foot is Foot.RIGHT:
            sideways, turn = -sideways, -turn
        if not _TURNS[0] <= turn <= _TURNS[-1] or not -_BACKWARD <= forward <= self._longest:
            return False
        if not self._least(turn) <= sideways <= self._width + _SIDEWAYS[-1]:
            return False
        place = (np.array([each]) for each in (forward, sideways, abs(goal.z - support.z)))
        return bool(self.within(*place)[0])


def _grid(
    x: tuple[float, float], y: tuple[float, float], *, spacing: float = _SPACING
) -> np.ndarray:
    """Points x + iy of a rectangle, at most `spacing` apart, (n,)."""
    along, across = (
        np.linspace(begin, end, math.ceil((end - begin) / spacing) + 1) for begin, end in (x, y)
    )
    grid: np.ndarray = (along[:, None] + 1j * across).ravel()
    return grid


def _placed(points: np.ndarray, places: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Points (m,) of a sole at each of the places (n,) with headings (n,), (n, m)."""
    placed: np.ndarray = places[:, None] + np.exp(1j * yaw)[:, None] * points
    return placed
