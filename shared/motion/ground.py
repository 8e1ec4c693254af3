"""The ground as a height map: level rectangles and slopes, the same for planner, plant and viewer.

Heights count from the ground on which the robot begins, which is level around the origin. Outside
all patches the height is 0. `make_ground` makes the ground that a setting describes:

    flat           no patches
    blocks:2cm     square blocks of random heights within ± 2 cm, drawn from the seed
    stairs:3x6cm   three stairs of 6 cm up, a landing, and three down again; -6cm: down first
    gap:10cm       a hole across the way, 10 cm wide
    slope:8deg     a slope up, a landing, and a slope down again; -8deg: down first
    FILE.npz       the user's own height map, see `read_ground`
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from shared.config.quantities import parse_ground
from shared.errors import ConfigError
from shared.npz_file import read_npz

# The height of a hole: deeper than a foot reaches [m].
HOLE = -0.5
# Where the described grounds begin and how far they go to both sides [m]. Romeo's toes are at 0.13.
_BEGIN, _SIDE = 0.2, 2.0
# Edge of a block, depth of a stair, length of a slope and of a landing [m].
_BLOCK, _TREAD, _SLOPE, _LANDING = 0.3, 0.3, 1.5, 1.0
_BLOCKS_END = 5.0
# The robot begins within this distance of the origin, ahead and to the side [m].
_START = (0.15, 0.2)
_SPACING = 0.01
# Beyond all ground [m].
_FAR = 1e6

_MAX_CELLS, _MAX_PATCHES = 500, 2000
_CELL = (0.01, 1.0)
_MAX_HEIGHT = 1.0
_MAX_BYTES = 20_000_000


@dataclass(frozen=True)
class Patch:
    """A rectangle of ground, `x` and `y` from … to [m].

    It has the height `z` [m] at the lower end of `x`, and rises by `rise` along x [m/m]. No foot
    may be set on it unless it is `allowed`, as it is not in a hole.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    z: float
    rise: float = 0.0
    allowed: bool = True

    @property
    def middle(self) -> float:
        """Height in the middle [m]."""
        return self.z + self.rise * (self.x[1] - self.x[0]) / 2

    def box(self, half_height: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Return centre (3,) and half sizes (3,) [m] of a box with the patch as its upper side.

        The third value is the angle by which its x axis points upwards [rad].
        """
        tilt = math.atan(self.rise)
        length = (self.x[1] - self.x[0]) / 2 / math.cos(tilt)
        half = np.array([length, (self.y[1] - self.y[0]) / 2, half_height])
        top = np.array([sum(self.x) / 2, sum(self.y) / 2, self.middle])
        return top + half_height * np.array([math.sin(tilt), 0.0, -math.cos(tilt)]), half, tilt


@dataclass(frozen=True)
class Ground:
    """A ground made of patches that do not overlap."""

    patches: tuple[Patch, ...] = ()

    @property
    def flat(self) -> bool:
        """Return whether the ground is level everywhere, and allowed everywhere."""
        return not self.patches

    def height(self, x: float, y: float) -> float:
        """Height at a point of the world [m]."""
        if not self.patches:
            return 0.0
        x0, x1, y0, y1, z, rise, _ = self._columns
        patch = ((x0 <= x) & (x < x1) & (y0 <= y) & (y < y1)).argmax()
        return float(z[patch] + rise[patch] * (x - x0[patch]))

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Heights at points (n, 2) of the world, (n,) [m]."""
        x0, _, _, _, z, rise, _ = self._columns
        patch = self._patch_of(points)
        heights: np.ndarray = z[patch] + rise[patch] * (points[:, 0] - x0[patch])
        return heights

    def allowed(self, points: np.ndarray) -> np.ndarray:
        """Return whether a foot may be set on each of the points (n, 2), (n,)."""
        allowed: np.ndarray = self._columns[-1][self._patch_of(points)] > 0.0
        return allowed

    def is_level(self, sole: np.ndarray, *, tolerance: float = 1e-3) -> bool:
        """Check that the ground under a sole is level within `tolerance` [m], and allowed.

        `sole` has its corners (4, 2) in the world, in the order of `FootDescription.corners`. The
        ground is looked at in points at most 1 cm apart.
        """
        points = _points_within(sole)
        heights = self.heights(points)
        return bool(np.ptp(heights) <= tolerance and self.allowed(points).all())

    @cached_property
    def _columns(self) -> np.ndarray:
        """x[0], x[1], y[0], y[1], z, rise, allowed of the patches and of the rest, (7, k + 1)."""
        rows = [(*each.x, *each.y, each.z, each.rise, each.allowed) for each in self.patches]
        return np.array([*rows, (-_FAR, _FAR, -_FAR, _FAR, 0.0, 0.0, True)], dtype=float).T.copy()

    def _patch_of(self, points: np.ndarray) -> np.ndarray:
        """Number of the patch at each point, (n,)."""
        x, y = points[:, :1], points[:, 1:2]
        x0, x1, y0, y1 = self._columns[:4]
        patch: np.ndarray = ((x0 <= x) & (x < x1) & (y0 <= y) & (y < y1)).argmax(axis=1)
        return patch


FLAT = Ground()


def make_ground(text: str, *, seed: int) -> Ground:
    """Make the ground that a setting describes.

    Raise `ConfigError` if it has no such form or if its file cannot be used.
    """
    spec = parse_ground(text)
    if spec.kind == "file":
        return read_ground(Path(spec.file))
    if spec.kind == "blocks":
        return Ground(tuple(_blocks(spec.size, np.random.default_rng([seed, 21]))))
    strips: list[tuple[float, float, float]] = []  # length, height at its beginning, rise
    if spec.kind == "stairs":
        up = [(_TREAD, k * spec.size, 0.0) for k in range(1, spec.count)]
        top = (_TREAD + _LANDING, spec.count * spec.size, 0.0)
        strips = [*up, top, *reversed(up)]
    elif spec.kind == "gap":
        strips = [(_START[0], 0.0, 0.0), (spec.size, HOLE, 0.0)]
    elif spec.kind == "slope":
        rise = math.tan(spec.size)
        top_z = _SLOPE * rise
        strips = [(_SLOPE, 0.0, rise), (_LANDING, top_z, 0.0), (_SLOPE, top_z, -rise)]
    return Ground(tuple(_across(strips)))


def _across(strips: Iterable[tuple[float, float, float]]) -> Iterable[Patch]:
    """Yield strips of ground across the way, one behind the other."""
    x = _BEGIN
    for length, z, rise in strips:
        yield Patch((x, x + length), (-_SIDE, _SIDE), z, rise, allowed=z > HOLE)
        x += length


def _blocks(height: float, rng: np.random.Generator) -> Iterable[Patch]:
    rows, columns = round((_BLOCKS_END - _BEGIN) / _BLOCK), 2 * round(_SIDE / _BLOCK)
    heights = np.round(rng.uniform(-height, height, (rows, columns)), 4)
    for (row, column), z in np.ndenumerate(heights):
        x, y = _BEGIN + row * _BLOCK, (column - columns // 2) * _BLOCK
        yield Patch((x, x + _BLOCK), (y, y + _BLOCK), float(z))


def read_ground(path: Path) -> Ground:
    """Read a height map from a `.npz` file.

    `heights` (n, m) [m] are those of square cells, the first index along x and the second along y.
    A cell that is not a number is a hole. `cell` is their edge [m]. `origin` (2,) is the corner of
    the first cell with the least x and y [m]. `forbidden` (n, m), which may be missing, is true
    where no foot may be set. Outside the map the height is 0.

    Raise `ConfigError` if the file cannot be read or used.
    """
    try:
        arrays = read_npz(path, at_most=_MAX_BYTES, array_at_most=8 * _MAX_CELLS**2 + 1024)
        heights, cell, origin = _checked(arrays)
        forbidden = arrays.get("forbidden", np.zeros(heights.shape, dtype=bool))
        if forbidden.shape != heights.shape or forbidden.dtype != bool:
            raise ValueError(
                f"forbidden: expected truth values of shape {heights.shape}, got "
                f"{forbidden.dtype} of shape {forbidden.shape}"
            )
        patches = _merged(heights, forbidden, cell=cell, origin=origin)
        ground = Ground(tuple(itertools.islice(patches, _MAX_PATCHES + 1)))
        if len(ground.patches) > _MAX_PATCHES:
            raise ValueError(
                f"heights: expected at most {_MAX_PATCHES} rectangles of equal height, got more; "
                "round the heights, to 1 cm for example, or use larger cells"
            )
        around = np.array([[sx * _START[0], sy * _START[1]] for sx in (-1, 1) for sy in (-1, 1)])
        if ground.height(0.0, 0.0) != 0.0 or not ground.is_level(around):
            raise ValueError(
                f"heights: expected level ground of height 0 within {_START[0]:g} m of the origin "
                f"along x and {_START[1]:g} m along y, where the robot begins, got other ground"
            )
    except OSError as error:
        raise ConfigError(f"ground {path}: cannot read it: {error.strerror}") from None
    except (KeyError, ValueError) as error:
        raise ConfigError(f"ground {path}: {error.args[0]}") from None
    return ground


def _checked(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, float, tuple[float, float]]:
    """Heights without NaN, cell and origin of a file. Raise `ValueError` if they cannot be used."""
    missing = [name for name in ("heights", "cell", "origin") if name not in arrays]
    if missing:
        found = ", ".join(sorted(arrays)) or "none"
        raise ValueError(f"expected arrays heights, cell and origin, got {found}")
    heights, cell, origin = arrays["heights"], arrays["cell"], arrays["origin"]
    if any(array.dtype.kind not in "iuf" for array in (heights, cell, origin)):
        raise ValueError("expected numbers in heights, cell and origin, got other values")
    if heights.ndim != 2 or not heights.size or max(heights.shape) > _MAX_CELLS:
        raise ValueError(
            f"heights: expected a table of at most {_MAX_CELLS} × {_MAX_CELLS} cells, got shape "
            f"{heights.shape}"
        )
    if cell.size != 1 or not _CELL[0] <= float(cell.ravel()[0]) <= _CELL[1]:
        raise ValueError(f"cell: expected a length of {_CELL[0]:g} to {_CELL[1]:g} m, got {cell}")
    if origin.shape != (2,) or not (np.abs(origin.astype(float)) <= _MAX_CELLS).all():
        raise ValueError(f"origin: expected two coordinates [m], got {origin}")
    z = np.where(np.isnan(heights.astype(float)), HOLE, heights.astype(float))
    if not (np.abs(z) <= _MAX_HEIGHT).all():
        raise ValueError(
            f"heights: expected at most ±{_MAX_HEIGHT:g} m, or NaN for a hole, got more"
        )
    x, y = origin.tolist()
    return z, float(cell.ravel()[0]), (x, y)


def _merged(
    heights: np.ndarray, forbidden: np.ndarray, *, cell: float, origin: tuple[float, float]
) -> Iterable[Patch]:
    """Yield rectangles of equal cells: each as long as possible along y, then along x."""
    done = np.zeros(heights.shape, dtype=bool)
    n, m = heights.shape
    for i, j in np.ndindex(n, m):
        if done[i, j]:
            continue
        equal = (heights == heights[i, j]) & (forbidden == forbidden[i, j]) & ~done
        columns = _run(equal[i, j:])
        rows = _run(equal[i:, j : j + columns].all(axis=1))
        done[i : i + rows, j : j + columns] = True
        yield Patch(
            (origin[0] + i * cell, origin[0] + (i + rows) * cell),
            (origin[1] + j * cell, origin[1] + (j + columns) * cell),
            float(heights[i, j]),
            allowed=bool(heights[i, j] > HOLE and not forbidden[i, j]),
        )


def _run(true: np.ndarray) -> int:
    """Length of the run of true values that begins an array (n,)."""
    return len(true) if true.all() else int(true.argmin())


def _points_within(corners: np.ndarray) -> np.ndarray:
    """Points of a rectangle with these corners (4, 2), at most 1 cm apart, (n, 2)."""
    along, across = corners[2] - corners[0], corners[1] - corners[0]
    counts = (math.ceil(np.linalg.norm(way) / _SPACING) + 1 for way in (along, across))
    u, v = np.meshgrid(*(np.linspace(0.0, 1.0, count) for count in counts))
    points: np.ndarray = corners[0] + u.reshape(-1, 1) * along + v.reshape(-1, 1) * across
    return points
