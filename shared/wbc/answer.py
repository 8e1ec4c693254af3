"""The edge's answers to a state: a projector with its time of validity, or a factorisation.

The robot applies them. It needs neither a solver nor LAPACK for that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from shared.wbc.contacts import ContactMode


def no_rows() -> np.ndarray:
    """Indices of no row, (0,)."""
    return np.empty(0, dtype=int)


@dataclass(frozen=True, slots=True)
class Projector:
    """A† of one optimal active set. `A_dagger` (n, n_rows + k); `active` row indices of C.

    `limits` (k,) are the active limits by their entry of b after the layout's rows. Their columns
    are the last ones.
    """

    mode: ContactMode
    A_dagger: np.ndarray
    active: np.ndarray
    limits: np.ndarray = field(default_factory=no_rows)

    @property
    def active_set(self) -> int:
        """`active` as a bit mask, see `ContactMode.active_set`."""
        return self.mode.active_set(self.active)

    def apply(self, b: np.ndarray) -> np.ndarray:
        """y = A† b, Eq. (4); shape (n,): accelerations, then contact forces."""
        y: np.ndarray = self.A_dagger.dot(self.entries_of(b))
        return y

    def entries_of(self, b: np.ndarray) -> np.ndarray:
        """The entries of b that have a column: the layout's rows, then the active limits."""
        k = len(self.limits)
        n_rows = self.A_dagger.shape[1] - k
        if len(b) > n_rows:
            b = np.concatenate([b[:n_rows], b[n_rows + self.limits]]) if k else b[:n_rows]
        return b


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
