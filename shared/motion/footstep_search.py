"""Footsteps to a goal over a known ground, by weighted A* over footholds.

A state is the foot that was placed last. Its successors are the footholds of the other foot on a
grid of (forward, sideways, turn) beside it. A foothold counts if the ground under the sole, and a
margin around it, is level and allowed, and if the legs reach it. The cost of a step is 1, and a
little more for steps sideways, turns and climbs. The estimate of the steps to the goal is the
smaller one of two ways: turn, walk and turn, or walk sideways too. On ground that is not uniform,
the estimate uses the way of a point on a coarse grid around walls, holes and forbidden places.

The search checks the ground under a foothold coarsely when it lists the successors, and closely
when it expands the foothold. The search keeps at most `MAX_EXPANSIONS` states with their
successors. Method: Hornung, Dornbush, Likhachev and Bennewitz 2012, "Anytime search-based footstep
planning with suboptimality bounds", without the anytime part.
"""

from __future__ import annotations

import contextlib
import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shared.config.quantities import Goal
from shared.config.step_settings import WalkConfig
from shared.errors import ConfigError
from shared.motion.foothold_reach import (
    CLIMB,
    FORWARD_GRID,
    SIDEWAYS,
    TURNS,
    Actions,
    FootholdReach,
)
from shared.motion.footprint import Footprint
from shared.motion.footsteps import Step, standing_footprints
from shared.motion.ground import Ground, Patch
from shared.motion.height_table import HeightTable, placed
from shared.motion.planned import other
from shared.robots import Foot, Robot

# Points in the plane are complex numbers x + iy here, so that a turn is a product. A search gives
# up after this number of states.
MAX_EXPANSIONS = 1000
# Highest ground that a foot passes over [m].
_OVER = 0.12
# Fastest swing, on the average [m/s].
_FASTEST = 0.5
# The distance of points of a sole [m].
_SPACING = 0.02
# Least distance of a landing foot from higher ground ahead and behind, beside the 1 cm from any
# edge [m].
_AHEAD = 0.02
# Nodes that a part of a search looks at.
_PART = 50
# Successors of a node whose ground is checked closely at a time.
_CHECKED = 8
# Two states are the same within this [m, rad].
_SAME, _SAME_BEHIND, _SAME_TURN = 0.04, 0.12, 0.12
# A way that is longer than the direct one by this factor goes round an obstacle.
_ROUND = 1.2
# Weight of the estimate: larger finds a way sooner, and a longer one.
_GREED = 2.5
# The largest distance of the feet from a goal without level ground [m].
_NEAR, _NEAR_GRID = 0.16, 0.02


class NoFootstepsError(ConfigError):
    """No sequence of steps to the goal was found."""


class FootstepSearch:
    """The search of one robot for steps over a ground to a goal, from any stance.

    It keeps the table of heights from one search to the next.
    """

    def __init__(
        self,
        robot: Robot,
        config: WalkConfig,
        ground: Ground,
        goal: Goal,
        *,
        forbidden: Sequence[Patch] = (),
        slopes: bool = False,
    ) -> None:
        """Prepare the search.

        `forbidden` are further places where no foot may be set. With `slopes`, a sole may be set on
        a slope.
        """
        stance = standing_footprints(robot)
        self._standing = stance[Foot.LEFT], stance[Foot.RIGHT]
        self._ground, self._forbidden = ground, tuple(forbidden)
        self._problem = _Problem(robot, config, goal, stance)
        self._slopes = slopes
        self._table: HeightTable | None = None

    def steps(self, start: tuple[Footprint, Footprint] | None = None) -> tuple[Step, ...]:
        """Find the steps from a stance (left, right; None: standing) to the goal.

        Raise `NoFootstepsError` with the reason if there is no way, or if the search gives up.
        """
        return next(found for found in self.search(start or self._standing) if found is not None)

    def search(
        self, start: tuple[Footprint, Footprint], *, first: Foot | None = None
    ) -> Iterator[tuple[Step, ...] | None]:
        """Search a part at a time: yield None after each part, and the steps at the end.

        The foot `first` swings first, if there is a way so. Raise `NoFootstepsError` as `steps`
        does.
        """
        goal = self._problem.goal
        places = np.array([complex(each.x, each.y) for each in start])
        if self._table is None or not self._table.covers(places):
            at_goal = complex(goal.x, goal.y)
            self._table = HeightTable(
                self._ground, self._forbidden, places, at_goal, slopes=self._slopes
            )
        if first is not None:
            with contextlib.suppress(NoFootstepsError):
                yield from _Search(self._problem, self._table).run(start, first)
                return
        yield from _Search(self._problem, self._table).run(start)


def find_footsteps(
    robot: Robot,
    config: WalkConfig,
    ground: Ground,
    goal: Goal,
    *,
    start: tuple[Footprint, Footprint] | None = None,
    forbidden: Sequence[Patch] = (),
    slopes: bool = False,
) -> tuple[Step, ...]:
    """Find steps once, see `FootstepSearch`."""
    search = FootstepSearch(robot, config, ground, goal, forbidden=forbidden, slopes=slopes)
    return search.steps(start)


class _Problem:
    """A robot, its way of walking and its goal."""

    def __init__(
        self, robot: Robot, config: WalkConfig, goal: Goal, stance: dict[Foot, Footprint]
    ) -> None:
        self.goal = goal
        self.width = config.step_width or stance[Foot.LEFT].y - stance[Foot.RIGHT].y
        self.middle_x = (stance[Foot.LEFT].x + stance[Foot.RIGHT].x) / 2
        longest = abs(config.step_length)
        if longest < FORWARD_GRID:
            raise ConfigError(
                f"walk.step_length: expected at least {FORWARD_GRID:g} m to go to a goal, got "
                f"{config.step_length:g}"
            )
        self.longest_swing = _FASTEST * (config.step_duration - config.double_support)
        # The mean way of a step, if each foot swings past the other one.
        self.advance = min(longest, self.longest_swing / 2)
        self.reach = FootholdReach(robot, config, self.width)
        self.actions: dict[Foot, Actions] = {foot: self.reach.actions(foot) for foot in Foot}
        soles = {sole.side: sole for sole in robot.soles}
        self.soles = {side: _grid(sole.x, sole.y) for side, sole in soles.items()}
        self.sole_radius = max(float(np.abs(sole).max()) for sole in self.soles.values())
        # Two lines of points ahead of the sole, and two behind it.
        self.ahead = {
            side: np.concatenate(
                [
                    _grid((sole.x[0] - _AHEAD,) * 2, sole.y),
                    _grid((sole.x[1] + _AHEAD,) * 2, sole.y),
                ]
            )
            for side, sole in soles.items()
        }
        self.coarse = {
            side: _grid(sole.x, sole.y, spacing=2 * _SPACING) for side, sole in soles.items()
        }


@dataclass(frozen=True, slots=True)
class _Node:
    """A placed foot. `level`: the ground under it is level, by the close check. `arrived`: this
    foot is in its place at the goal. `done`: both feet are.
    """

    cost: float
    placed: Footprint
    parent: _Node | None
    level: bool = True
    arrived: bool = False
    done: bool = False

    @property
    def start(self) -> Footprint | None:
        """The earlier footprint of the same foot; None at the beginning."""
        before = None if self.parent is None else self.parent.parent
        return None if before is None else before.placed

    @property
    def behind(self) -> Footprint:
        """The footprint from which the other foot swings after this one was placed."""
        return self.placed if self.parent is None else self.parent.placed

    @property
    def key(self) -> tuple[object, ...]:
        """The cell of the state. The search keeps one state per cell.

        The coarse cell of the other foot decides how far that foot can swing.
        """
        at, behind = self.placed, self.behind
        return (
            at.foot,
            round(at.x / _SAME),
            round(at.y / _SAME),
            round(at.yaw / _SAME_TURN),
            round(behind.x / _SAME_BEHIND),
            round(behind.y / _SAME_BEHIND),
            self.arrived,
            self.done,
        )


# The rank and the number of a node. The number makes the order of equal ranks.
_Ranked = tuple[float, int, _Node]


class _Queue:
    """Nodes in the order of their ranks.

    The successors of a node come in this order too. So only the first one of them waits in the
    heap, and most of them are never made.
    """

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, _Node, Iterator[_Ranked]]] = []

    def __bool__(self) -> bool:
        return bool(self._heap)

    def add(self, nodes: Iterator[_Ranked]) -> None:
        """Add nodes in the order of their ranks."""
        first = next(nodes, None)
        if first is not None:
            heapq.heappush(self._heap, (*first, nodes))

    def pop(self) -> _Node:
        """Remove and return the first node."""
        _, _, node, following = heapq.heappop(self._heap)
        self.add(following)
        return node


class _Search:
    """One search over a table of heights."""

    def __init__(self, problem: _Problem, table: HeightTable) -> None:
        self._problem = problem
        self._goal = problem.goal
        self._table = table
        self._queue = _Queue()
        self._count = 0
        self._sole_cells: dict[tuple[Foot, float], np.ndarray] = {}

    def run(
        self, start: tuple[Footprint, Footprint], first: Foot | None = None
    ) -> Iterator[tuple[Step, ...] | None]:
        """Yield the steps from a stance (left, right) at the end, and None at times before.

        The foot `first` swings first; None: the better one of both.
        """
        goals = self._stance_at_goal()
        stances = [start, start[::-1]]
        # If both ways are as good, the foot on the side of the goal goes first.
        if self._goal.y > 0.0 or (self._goal.y == 0.0 and self._goal.yaw > 0.0):
            stances.reverse()
        for support, swing in stances:
            if first not in (None, swing.foot):
                continue
            node = _Node(0.0, support, _Node(0.0, swing, None))
            self._expand(node, goals)
        known: set[tuple[object, ...]] = set()
        expansions = looked_at = 0
        while self._queue and expansions < MAX_EXPANSIONS and looked_at < 4 * MAX_EXPANSIONS:
            node = self._queue.pop()
            key = node.key
            if key in known:
                continue
            looked_at += 1
            if looked_at % _PART == 0:
                yield None
            if not (node.level and self._passes(node)):
                continue
            if node.done:
                yield tuple(self._steps(node))
                return
            known.add(key)
            expansions += 1
            self._expand(node, goals)
        raise NoFootstepsError(
            f"goal: found no way to {self._goal.x:g}, {self._goal.y:g} over this ground in "
            f"{expansions} footholds; try a larger walk.step_length or walk.com_lowering, or a "
            "nearer goal"
        )

    def _stance_at_goal(self) -> dict[Foot, Footprint]:
        """Footprints on level ground nearest to the goal."""
        goal, problem = self._goal, self._problem
        steps = np.arange(-_NEAR, _NEAR + 1e-9, _NEAR_GRID)
        # Symmetric, so that the nearest of a goal to the left mirrors that of one to the right.
        off = (steps[:, None] + 1j * steps).ravel() if not self._table.uniform else np.zeros(1)
        off = off[np.lexsort((np.abs(off.imag), np.round(np.abs(off), 9)))]
        turn = complex(math.cos(goal.yaw), math.sin(goal.yaw))
        # Mostly the first place is level.
        for some in (off[:1], off[1:]):
            # As in standing, the place of the goal is below the base.
            places = {
                foot: complex(goal.x, goal.y)
                + turn * (some + complex(problem.middle_x, side * problem.width / 2))
                for foot, side in ((Foot.LEFT, 1.0), (Foot.RIGHT, -1.0))
            }
            yaw = np.full(len(some), goal.yaw)
            found = {foot: self._footholds(foot, at, yaw) for foot, at in places.items()}
            apart = np.abs(found[Foot.LEFT][1] - found[Foot.RIGHT][1])
            both = found[Foot.LEFT][0] & found[Foot.RIGHT][0] & (apart <= CLIMB / 2)
            if both.any():
                k = int(np.argmax(both))
                return {
                    foot: Footprint(
                        foot, at[k].real, at[k].imag, goal.yaw, float(found[foot][1][k])
                    )
                    for foot, at in places.items()
                }
        by_touch = ", or steps by touch over a slope (--stepping on)"
        raise NoFootstepsError(
            f"goal: expected level ground for both feet within {_NEAR:g} m of "
            f"{goal.x:g}, {goal.y:g}, found none; try another goal"
            f"{by_touch if self._table.refuses_slopes else ''}"
        )

    def _expand(self, node: _Node, goals: dict[Foot, Footprint]) -> None:
        """Queue the footholds of the other foot that are within reach of a node."""
        problem, table = self._problem, self._table
        support, behind = node.placed, node.behind
        foot = other(support.foot)
        swings_from = complex(behind.x, behind.y)
        last = goals[foot]
        swing = abs(complex(last.x, last.y) - swings_from)
        if swing <= problem.longest_swing and problem.reach.holds(support, last):
            rank = node.cost + 1.0 + _GREED * (not node.arrived)
            arrived = _Node(node.cost + 1.0, last, node, arrived=True, done=node.arrived)
            self._queue.add(iter([(rank, self._count, arrived)]))
            self._count += 1
        actions = problem.actions[foot]
        heading = complex(math.cos(support.yaw), math.sin(support.yaw))
        places = complex(support.x, support.y) + heading * actions.offsets
        near = (np.abs(places - swings_from) <= problem.longest_swing).nonzero()[0]
        cells = table.cells_of(places[near])
        z = table.highest[cells]
        climb = np.abs(z - support.z)
        holds = problem.reach.within(actions.half[near], climb)
        yaws = support.yaw + actions.turns
        if not table.uniform:
            soles = np.array([self._cells_under(foot, yaw) for yaw in yaws.tolist()])
            holds &= table.level(cells, soles[actions.turn[near]])
        near, z, climb = near[holds], z[holds], climb[holds]
        turn, places = actions.turn[near], places[near]
        costs = node.cost + 1.0 + actions.cost[near] + 2.0 * climb
        ranks = costs + _GREED * self._estimate(foot, places, yaws, turn)
        order = ranks.argsort(kind="stable")
        numbers = order + self._count
        self._count += len(order)
        columns = (ranks, numbers, costs, places, yaws[turn], z)
        ordered = [each if each is numbers else each[order] for each in columns]
        self._queue.add(self._successors(node, foot, *ordered))

    def _successors(
        self,
        node: _Node,
        foot: Foot,
        ranks: np.ndarray,
        numbers: np.ndarray,
        costs: np.ndarray,
        places: np.ndarray,
        yaw: np.ndarray,
        z: np.ndarray,
    ) -> Iterator[_Ranked]:
        """Yield the successors (n,) of a node in their order. Check the ground under some at a
        time.
        """
        level = np.ones(_CHECKED, dtype=bool)
        for begin in range(0, len(ranks), _CHECKED):
            some = slice(begin, begin + _CHECKED)
            if not self._table.uniform:
                level, _ = self._footholds(foot, places[some], yaw[some])
            columns = (ranks, numbers, costs, places, yaw, z)
            for rank, number, cost, place, angle, height, is_level in zip(
                *(each[some].tolist() for each in columns), level.tolist(), strict=False
            ):
                footprint = Footprint(foot, place.real, place.imag, angle, height)
                yield rank, number, _Node(cost, footprint, node, is_level)

    def _cells_under(self, foot: Foot, yaw: float) -> np.ndarray:
        """Cells of the coarse points of a sole with a heading, see `HeightTable.sole_cells`."""
        key = foot, round(yaw, 6)
        if key not in self._sole_cells:
            self._sole_cells[key] = self._table.sole_cells(self._problem.coarse[foot], yaw)
        return self._sole_cells[key]

    def _passes(self, node: _Node) -> bool:
        """Return whether the ground is low enough on the way of a foot."""
        at, start = node.placed, node.start
        if self._table.uniform or start is None:
            return True
        most = max(start.z, at.z) + _OVER
        ends = complex(start.x, start.y), complex(at.x, at.y)
        if self._table.highest_around(*ends, radius=self._problem.sole_radius) <= most:
            return True
        return self._highest_between(start, at) <= most

    def _footholds(
        self, foot: Foot, places: np.ndarray, yaw: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return whether the ground is level under soles at places (n,) and headings (n,), and its
        heights (n,) [m].
        """
        table, sole = self._table, self._problem.soles[foot]
        z = table.highest[table.cells_of(places)]
        points = np.concatenate((sole, self._problem.ahead[foot]))
        at = placed(points, places, yaw)
        cells = table.cells_of(at)
        plane, tolerance = table.plane(at, places)
        lowest = (table.lowest[cells] - plane)[:, : len(sole)].min(axis=1)
        highest = (table.highest[cells] - plane).max(axis=1)
        return (lowest >= z - tolerance) & (highest <= z + tolerance), z

    def _estimate(
        self, foot: Foot, places: np.ndarray, yaws: np.ndarray, turn: np.ndarray
    ) -> np.ndarray:
        """Steps from placed feet (n,) to the goal, (n,). Their headings are `yaws[turn]`."""
        problem, goal = self._problem, self._goal
        inward = -problem.width / 2 if foot is Foot.LEFT else problem.width / 2
        heading = np.exp(1j * yaws)[turn]
        base = places + heading * complex(-problem.middle_x, inward)
        # The way in the frame of the foot.
        way = (complex(goal.x, goal.y) - base) * heading.conj()
        forward, sideways = np.abs(way.real), np.abs(way.imag)
        towards = np.angle(way)
        left = (np.remainder(goal.yaw - yaws + math.pi, math.tau) - math.pi)[turn]
        last = np.remainder(left - towards + math.pi, math.tau) - math.pi
        turns, left = np.abs(towards) + np.abs(last), np.abs(left)
        turning = (TURNS[2] - TURNS[0]) / 2
        distance = np.abs(way)
        detour = self._table.detour(base, distance)
        # Round an obstacle the direction of the goal means nothing.
        turns = np.where(detour > _ROUND, left, turns)
        straight = detour * distance / problem.advance + turns / turning
        across = forward / problem.advance + 2.0 * sideways / SIDEWAYS[-1] + left / turning
        estimate: np.ndarray = np.minimum(straight, detour * across)
        return estimate

    def _highest_between(self, start: Footprint, goal: Footprint) -> float:
        """Highest ground under a sole on its straight way between two footprints."""
        begin, way = complex(start.x, start.y), complex(goal.x - start.x, goal.y - start.y)
        share = np.linspace(0.0, 1.0, 2 + math.ceil(abs(way) / 0.05))
        places = begin + share * way
        yaw = start.yaw + share * math.remainder(goal.yaw - start.yaw, math.tau)
        points = placed(self._problem.soles[goal.foot], places, yaw)
        return float(self._table.highest[self._table.cells_of(points)].max())

    def _steps(self, node: _Node) -> list[Step]:
        steps = []
        while (start := node.start) is not None and node.parent is not None:
            highest = self._highest_between(start, node.placed)
            steps.append(Step(node.parent.placed, start, node.placed, highest))
            node = node.parent
        return steps[::-1]


def _grid(
    x: tuple[float, float], y: tuple[float, float], *, spacing: float = _SPACING
) -> np.ndarray:
    """Points x + iy of a rectangle, at most `spacing` apart, (n,)."""
    along, across = (
        np.linspace(begin, end, math.ceil((end - begin) / spacing) + 1) for begin, end in (x, y)
    )
    grid: np.ndarray = (along[:, None] + 1j * across).ravel()
    return grid
