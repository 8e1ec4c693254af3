"""The edge's answers to a state: a projector with its time of validity, or a factorisation.

The robot applies them. It needs neither a solver nor LAPACK for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.wbc.contacts import ContactMode


@dataclass(frozen=True, slots=True)
class Projector:
    """A† of one optimal active set. `A_dagger` (n, n_rows); `active` row indices of C."""

    mode: ContactMode
    A_dagger: np.ndarray
    active: np.ndarray

    @property
    def active_set(self) -> int:
        """`active` as a bit mask, see `ContactMode.active_set`."""
        return self.mode.active_set(self.active)

    def apply(self, b: np.ndarray) -> np.ndarray:
        """y = A† b, Eq. (4); shape (n,): accelerations, then contact forces."""
        y: np.ndarray = self.A_dagger.dot(b)
        return y


@dataclass(frozen=True, slots=True)
class TimedProjector:
    """A projector with the task times between which it may be used [ns]."""

    projector: Projector
    valid_from_ns: int
    valid_until_ns: int


@dataclass(frozen=True, slots=True)
class Factorisation:
    """Blocks of the inverse KKT matrix of one contact mode at one posture.

    `P` (n, n) symmetric, `Q` (n, n_e), `T` (n_e, n_e) symmetric, `A` (n_t, nv) the √ω-weighted task
    rows; `posture` (nv − 6,) joint positions at which they were computed [rad]. No block depends on
    the position or orientation of the base.
    """

    mode: ContactMode
    P: np.ndarray
    Q: np.ndarray
    T: np.ndarray
    A: np.ndarray
    posture: np.ndarray
