"""Heights of a ground in cells of 1 cm around the places of a search for footsteps.

Points in the plane are complex numbers x + iy, so that a turn is a product. The table has the
height of the ground in a cell and around it, and knows whether the ground under a sole is level. It
also has the length of the way of a point to the goal, around walls, holes and forbidden places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from shared.motion.foothold_reach import CLIMB
from shared.motion.ground import Ground, Patch

# Heights of level ground differ by less [m].
_TOLERANCE = 3e-3
# The edge of a cell [m], and the margin of the table around the places of a search [m].
_CELL, _AROUND = 0.01, 0.6
# Edge of a coarse cell in cells, and the factor on the length of a way across a wall or a hole.
_COARSE, _WALL = 4, 4.0
# Half of the width of a stance, in coarse cells.
_HALF_STANCE = 4
# The steepest slope that a foot is set on, 10.5° [m/m].
_STEEPEST = 0.185
# The part of the heights in a slope that is due to the cells, in cells.
_ROUNDING_CELLS = 3.0
# The height of a place where no foot may be set [m]; the rim of the table in cells.
_NOWHERE, _RIM = -3.0, 40


class HeightTable:
    """Heights of the ground in cells, and the lowest and highest within a cell around each.

    `highest` and `lowest` are raveled: see `cells_of`. The ground is `uniform` if it has one height
    in the whole table and is allowed everywhere.
    """

    def __init__(
        self,
        ground: Ground,
        forbidden: Sequence[Patch],
        places: np.ndarray,
        goal: complex,
        *,
        slopes: bool = False,
    ) -> None:
        """Make the table around places (n,) and the goal.

        `forbidden` are further places where no foot may be set. With `slopes`, even ground of a
        small slope counts as level. Without, the table `refuses_slopes` if there are any.
        """
        points = np.append(places, goal).view(float).reshape(-1, 2)
        self._low = np.floor((points.min(axis=0) - _AROUND) / _CELL).astype(int)
        shape = np.ceil((points.max(axis=0) + _AROUND) / _CELL).astype(int) - self._low
        table, rise = np.zeros(shape), np.zeros(shape)
        closed = np.zeros(shape, dtype=bool)
        for patch in ground.patches:
            rows, columns = self._span(patch.x, 0, shape), self._span(patch.y, 1, shape)
            x = (np.arange(rows.start, rows.stop) + self._low[0] + 0.5) * _CELL
            table[rows, columns] = (patch.z + patch.rise * (x - patch.x[0]))[:, None]
            rise[rows, columns] = patch.rise
            closed[rows, columns] = not patch.allowed
        for patch in forbidden:
            closed[self._span(patch.x, 0, shape), self._span(patch.y, 1, shape)] = True
        # Nothing is level with a place where no foot may be.
        lowest = np.where(closed, _NOWHERE, table)
        self.highest = _spread(table, np.maximum).ravel()
        self.lowest = _spread(lowest, np.minimum).ravel()
        self.refuses_slopes = bool(rise.any()) and not slopes
        rise[np.abs(rise) > _STEEPEST] = 0.0
        self._rise = rise.ravel() if slopes and rise.any() else None
        self._rows, self._columns = (int(n) for n in shape)
        self.uniform = bool(np.ptp(lowest) == 0.0)
        # Whole tenths of a millimetre, with a rim as wide as a sole, for `level`.
        self._fine_highest, self._fine_lowest = (
            np.pad((each * 1e4).astype(np.int16), _RIM, "edge").ravel() for each in (table, lowest)
        )
        self._ways = None if self.uniform else self._ways_to(goal)

    def covers(self, places: np.ndarray) -> bool:
        """Return whether all places (n,) are within the table by at least half of its margin."""
        count = np.array([self._rows, self._columns])
        cells = places.view(float).reshape(-1, 2) / _CELL - self._low
        margin = _AROUND / 2 / _CELL
        return bool((cells >= margin).all() and (cells <= count - margin).all())

    def cells_of(self, points: np.ndarray) -> np.ndarray:
        """Cells of points, as indices of a raveled table; one outside has the nearest cell."""
        row, column = points.real * (1.0 / _CELL), points.imag * (1.0 / _CELL)
        for at, low, count in zip(
            (row, column), self._low, (self._rows, self._columns), strict=True
        ):
            # In place, because most of the time of a search is spent here.
            np.floor(at, out=at)
            at -= low
            np.maximum(at, 0.0, out=at)
            np.minimum(at, count - 1.0, out=at)
        row *= self._columns
        row += column
        cells: np.ndarray = row.astype(int)
        return cells

    def highest_around(self, begin: complex, end: complex, *, radius: float) -> float:
        """Highest ground in the rectangle around two points, by `radius` larger [m]."""
        spans = []
        for axis, (a, b) in enumerate(((begin.real, end.real), (begin.imag, end.imag))):
            low, count = int(self._low[axis]), (self._rows, self._columns)[axis]
            first = math.floor((min(a, b) - radius) / _CELL) - low
            last = math.floor((max(a, b) + radius) / _CELL) - low
            spans.append(slice(max(0, min(first, count - 1)), max(0, min(last, count - 1)) + 1))
        table = self.highest.reshape(self._rows, self._columns)
        return float(table[spans[0], spans[1]].max())

    def detour(self, places: np.ndarray, direct: np.ndarray) -> np.ndarray:
        """Return the way from places (n,) to the goal by `direct` (n,) [m], at least 1."""
        if self._ways is None:
            return np.ones(len(places))
        row, column = np.divmod(self.cells_of(places), self._columns)
        ways = self._ways[row // _COARSE * -(-self._columns // _COARSE) + column // _COARSE]
        detour: np.ndarray = np.maximum(ways / np.maximum(direct, _COARSE * _CELL), 1.0)
        return detour

    def sole_cells(self, sole: np.ndarray, yaw: float) -> np.ndarray:
        """Cells of the points (n,) of a turned sole, relative to the cell of its origin, for
        `level`.
        """
        offsets = np.rint(placed(sole, np.zeros(1), np.array([yaw]))[0] / _CELL)
        cells: np.ndarray = (offsets.real * (self._columns + 2 * _RIM) + offsets.imag).astype(int)
        return cells

    def level(self, cells: np.ndarray, sole_cells: np.ndarray) -> np.ndarray:
        """Return whether the ground is level under soles with their origins in cells (n,).

        `sole_cells` (n, m) are those of the soles, see there. It is true wherever the ground is
        level with a margin of 1 cm.
        """
        row, column = np.divmod(cells, self._columns)
        origins = (row + _RIM) * (self._columns + 2 * _RIM) + column + _RIM
        under = origins[:, None] + sole_cells
        here = self._fine_highest[origins]
        top = np.maximum(here, self._fine_highest[under].max(axis=1))
        bottom = np.minimum(here, self._fine_lowest[under].min(axis=1))
        level: np.ndarray = top <= bottom + round(2e4 * _TOLERANCE)
        return level if self._rise is None else level | (self._rise[cells] != 0.0)

    def plane(self, points: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the height of points (n, m) above places (n,), on the plane of the slope there.

        The second value is the tolerance with which they are on it, (n,) [m].
        """
        if self._rise is None:
            return np.zeros((1, 1)), np.full(len(places), _TOLERANCE)
        rise = self._rise[self.cells_of(places)]
        # Both heights are those of a cell and of its neighbours.
        return rise[:, None] * (points.real - places.real[:, None]), _TOLERANCE + np.abs(
            _ROUNDING_CELLS * _CELL * rise
        )

    def _ways_to(self, goal: complex) -> np.ndarray:
        """Ways from the cells of a coarse grid to the goal [m], raveled."""
        # Imported here: it takes long, and flat ground does not need it.
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        shape = (self._rows, self._columns)
        steps = (self.highest - self.lowest).reshape(shape)
        # No step climbs higher.
        length = np.where(steps > CLIMB, _WALL, 1.0)
        padded = np.pad(length, [(0, -n % _COARSE) for n in shape], "edge")
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
        row, column = divmod(int(self.cells_of(np.array([goal]))[0]), self._columns)
        found: np.ndarray = dijkstra(
            graph, directed=False, indices=row // _COARSE * m + column // _COARSE
        )
        return found

    def _span(self, span: tuple[float, float], axis: int, shape: np.ndarray) -> slice:
        """Cells whose middle is in a span, within the table."""
        begin, end = (
            min(max(math.ceil(x / _CELL - 0.5) - int(self._low[axis]), 0), int(shape[axis]))
            for x in span
        )
        return slice(begin, end)


def placed(points: np.ndarray, places: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Points (m,) of a sole at each of the places (n,) with headings (n,), (n, m)."""
    at: np.ndarray = places[:, None] + np.exp(1j * yaw)[:, None] * points
    return at


def _spread(table: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Extreme of each cell and its eight neighbours."""
    for axis in (0, 1):
        table = np.moveaxis(table, axis, 0)
        spread = table.copy()
        extreme(spread[1:], table[:-1], out=spread[1:])
        extreme(spread[:-1], table[1:], out=spread[:-1])
        table = np.moveaxis(spread, 0, axis)
    return table
