"""Contact modes, and what a loaded sole adds to the QP: point forces, wrench map, friction rows.

A sole carries one force per corner of its (slightly shrunk) rectangle, in the *sole frame*. In that
frame the wrench map G and the friction rows C are constant: the robot knows them by itself.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from shared.robots import Foot, Robot, Sole

POINTS_PER_FOOT = 4
FORCES_PER_FOOT = 3 * POINTS_PER_FOOT
ROWS_PER_POINT = 5
ROWS_PER_FOOT = ROWS_PER_POINT * POINTS_PER_FOOT
# Corners are moved inwards so that the centre of pressure stays off the edge of the real sole [m].
CORNER_MARGIN = 0.005


class ContactMode(enum.IntEnum):
    """The set of loaded feet. The value travels on the wire."""

    DOUBLE_SUPPORT = 0
    LEFT_SUPPORT = 1
    RIGHT_SUPPORT = 2

    @property
    def label(self) -> str:
        """Its name in the terminal and in the view."""
        if self is ContactMode.DOUBLE_SUPPORT:
            return "both feet"
        return f"{self.feet[0].value} foot"

    @property
    def feet(self) -> tuple[Foot, ...]:
        """The loaded feet, left before right."""
        return _LOADED[self]

    @property
    def feet_indices(self) -> tuple[int, ...]:
        """The loaded feet as numbers: 0 left, 1 right."""
        return _LOADED_INDICES[self]

    def active_set(self, rows: np.ndarray) -> int:
        """Row indices of C in this mode as a bit mask that means the same in every mode.

        Bit 20 k + i stands for row i of foot k, left before right.
        """
        first = self.feet_indices[0] * ROWS_PER_FOOT
        return sum(1 << (first + row) for row in rows.tolist())


_LOADED = {
    ContactMode.DOUBLE_SUPPORT: (Foot.LEFT, Foot.RIGHT),
    ContactMode.LEFT_SUPPORT: (Foot.LEFT,),
    ContactMode.RIGHT_SUPPORT: (Foot.RIGHT,),
}
_LOADED_INDICES = {
    mode: tuple(k for k, foot in enumerate(Foot) if foot in feet) for mode, feet in _LOADED.items()
}


@dataclass(frozen=True)
class ContactGeometry:
    """Constant matrices of one contact mode, n_f = 12 per loaded foot.

    `wrench_map` per foot (6, 12): wrench = G f_foot, linear then angular, sole frame.
    `C` (5 · points, n_f), `l` (5 · points,): friction pyramid and least normal force, C f ≥ l.
    """

    mode: ContactMode
    wrench_map: dict[Foot, np.ndarray]
    C: np.ndarray
    l: np.ndarray  # noqa: E741  (the paper's letter)

    @property
    def n_forces(self) -> int:
        return FORCES_PER_FOOT * len(self.mode.feet)

    def wrenches(self, f: np.ndarray) -> dict[Foot, np.ndarray]:
        """Contact wrench of each loaded foot, (6,) in its sole frame, from f (n_f,) [N]."""
        return {
            foot: self.wrench_map[foot].dot(f[k * FORCES_PER_FOOT : (k + 1) * FORCES_PER_FOOT])
            for k, foot in enumerate(self.mode.feet)
        }


def contact_geometry(
    robot: Robot, mode: ContactMode, *, friction: float, min_normal_force: float
) -> ContactGeometry:
    """Wrench maps and friction rows of a mode; `min_normal_force` is per contact point [N]."""
    soles = {sole.side: sole for sole in robot.soles}
    n_points = POINTS_PER_FOOT * len(mode.feet)
    C = np.kron(np.eye(n_points), _pyramid(friction))
    bound = np.tile([0.0, 0.0, 0.0, 0.0, min_normal_force], n_points)
    return ContactGeometry(
        mode=mode,
        wrench_map={side: _wrench_map(soles[side]) for side in mode.feet},
        C=C,
        l=bound,
    )


def _pyramid(friction: float) -> np.ndarray:
    """Rows of one point, (5, 3): μ f_z ± f_x ≥ 0, μ f_z ± f_y ≥ 0, f_z ≥ least normal force."""
    return np.array(
        [
            [1.0, 0.0, friction],
            [-1.0, 0.0, friction],
            [0.0, 1.0, friction],
            [0.0, -1.0, friction],
            [0.0, 0.0, 1.0],
        ]
    )


def _wrench_map(sole: Sole) -> np.ndarray:
    blocks = []
    for x, y, z in sole.corners(CORNER_MARGIN):
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        blocks.append(np.vstack([np.eye(3), skew]))
    return np.hstack(blocks)
