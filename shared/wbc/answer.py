"""The edge's answers to a state: a projector with its time of validity, or a factorisation.

The robot applies them. It needs neither a solver nor LAPACK for that. The parts of an answer of
every millisecond are not frozen, because a frozen one takes five times as long to make.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.wbc.contacts import ContactMode


def no_rows() -> np.ndarray:
    """An empty array of row indices, (0,)."""
    return np.empty(0, dtype=int)


@dataclass(slots=True)
class Openness:
    """The open rows of a projector: the inequality rows, on which the robot decides.

    `limits` (k,) are the limits that are active or near, as indices of their entries of b after the
    layout's rows. The solution is A† b + `push` u, with `push` (n, k + n_f) and u (k + n_f,) of
    unit weight. The first k entries of u move the limited quantities inwards by `factor` u[:k],
    with `factor` (k, k) lower triangular. The forces move by the rows of `push` that belong to
    them. `shared/wbc/assisted.py` finds u.
    """

    limits: np.ndarray
    push: np.ndarray
    factor: np.ndarray


@dataclass(slots=True)
class Projector:
    """A† of one optimal active set. `A_dagger` (n, n_rows); `active` row indices of C.

    With the robot's own limits A† is that of the equalities alone, and `open` has the rows that the
    robot decides on.
    """

    mode: ContactMode
    A_dagger: np.ndarray
    active: np.ndarray
    open: Openness | None = None

    @property
    def active_set(self) -> int:
        """`active` as a bit mask, see `ContactMode.active_set`."""
        return self.mode.active_set(self.active)

    @property
    def size(self) -> int:
        """The number of entries in its arrays."""
        opened = self.open
        return self.A_dagger.size + (opened.push.size + opened.factor.size if opened else 0)

    def apply(self, b: np.ndarray) -> np.ndarray:
        """y = A† b, Eq. (4), shape (n,): accelerations, then contact forces."""
        n_rows = self.A_dagger.shape[1]
        y: np.ndarray = self.A_dagger.dot(b[:n_rows] if len(b) > n_rows else b)
        return y


@dataclass(slots=True)
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
