"""A stale factorisation corrected by exact residuals: chord steps, and the active set re-decided.

In one contact mode, without friction rows, the optimum of the whole-body QP is linear in (g, e).
With H = blockdiag(AᵀA, ω_f I) and g = (Aᵀs, 0),

    [ H  −Eᵀ ] [ y ]   [ g ]
    [ E   0  ] [ ν ] = [ e ],

    [ y ]   [  P   Q ] [ g ]
    [ ν ] = [ −Qᵀ  T ] [ e ].

The edge computes P, Q, T at the posture it knows. The robot, at its own state, takes the exact
residuals at its previous solution and corrects it by these stale blocks. The friction rows C f ≥ l
are constant, so it decides the active set itself. Level B keeps the stale trade-off between tasks.
Level C takes the exact gradient too and has the fresh optimum as its fixed point. For the terms of
multi-level real-time iterations see Bock, Diehl, Kostina & Schlöder 2007; Kirches, Wirsching, Bock
& Schlöder 2012. `docs/locally-corrected.md` derives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from shared.wbc.answer import Factorisation
from shared.wbc.contacts import FORCES_PER_FOOT, ContactMode
from shared.wbc.finite import all_finite
from shared.wbc.model import Kinematics, RowMultipliers, WholeBodyModel
from shared.wbc.stack import N_DYNAMICS, ROWS_PER_CONTACT, Stack


@dataclass(slots=True)
class Iterate:
    """The present result of the corrections in one contact mode: y (n,) and ν (n_e,)."""

    mode: ContactMode
    y: np.ndarray
    nu: np.ndarray

    @staticmethod
    def zero(stack: Stack) -> Iterate:
        """Return the zero iterate. One step of level B from it is the stale optimum with a fresh
        active set.
        """
        return Iterate(
            stack.mode, np.zeros(stack.layout.n_unknowns), np.zeros(stack.equality_rows.stop)
        )

    def in_mode(self, stack: Stack, n_a: int) -> Iterate:
        """The start in another contact mode: same accelerations, and forces of feet that stay."""
        iterate = Iterate.zero(stack)
        iterate.y[:n_a] = self.y[:n_a]
        for k, foot in enumerate(stack.mode.feet):
            if foot in self.mode.feet:
                j = self.mode.feet.index(foot)
                iterate.y[_forces(n_a, k)] = self.y[_forces(n_a, j)]
        return iterate


class Corrector:
    """Chord steps with one factorisation. Made when the factorisation arrives, used every tick.

    Raises `numpy.linalg.LinAlgError` if the forces' block of P is not positive definite.
    Not shared between threads: the small QP keeps its active set from one step to the next.
    """

    def __init__(self, stack: Stack, factorisation: Factorisation, *, level: str) -> None:
        self.factorisation = factorisation
        self._stack = stack
        self._level = level
        n_a = stack.layout.n_accelerations
        P, Q, A = factorisation.P, factorisation.Q, factorisation.A
        # From the residuals of all rows to the correction of y.
        self._K = np.ascontiguousarray(np.hstack([Q, P[:, :n_a] @ A.T]))
        self._regularisation = np.ascontiguousarray(stack.force_weight * P[:, n_a:])
        # λ acts through forces: moving f in the metric of P_ff⁻¹ moves y by P Cᵀ λ.
        self._F = _spd_inverse(P[n_a:, n_a:])
        self._y_from_f = np.ascontiguousarray(P[:, n_a:] @ self._F)
        self._qp = daqp.Model()
        C, l = stack.contacts.C, stack.contacts.l  # noqa: E741
        no_bound = np.full(len(l), 1e30)
        self._qp.setup(self._F, np.zeros(len(self._F)), C, no_bound, l, _SENSE[: len(l)])
        if self._project(np.zeros(len(self._F))) is None:
            raise np.linalg.LinAlgError("the forces' block of P is not definite enough")

    def step(
        self,
        iterate: Iterate,
        residual: np.ndarray,
        model: WholeBodyModel,
        now: Kinematics,
        *,
        relaxation: float = 1.0,
    ) -> tuple[Iterate, int] | None:
        """The corrected iterate and its active set as a bit mask; None if it is not finite.

        `residual` (n_rows,) is b − M y at the present state, `now` the kinematics there.
        """
        stack = self._stack
        n_a = stack.layout.n_accelerations
        y, nu = iterate.y, iterate.nu
        if self._level == "b":
            moved = self._K.dot(residual[:-1]) - self._regularisation.dot(y[n_a:])
            y = y + (moved if relaxation == 1.0 else relaxation * moved)
        else:
            gradient = self._gradient(iterate, residual, model, now)
            P, Q, T = self.factorisation.P, self.factorisation.Q, self.factorisation.T
            equalities = residual[stack.equality_rows]
            y = y + relaxation * (Q @ equalities - P @ gradient)
            nu = nu + relaxation * (Q.T @ gradient + T @ equalities)
        f = y[n_a:]
        if not all_finite(y):
            return None
        C, l = stack.contacts.C, stack.contacts.l  # noqa: E741
        if (C.dot(f) >= l).all():
            # Forces that obey the friction rows are the nearest that do.
            return Iterate(stack.mode, y, nu), 0
        projected = self._project(f)
        if projected is None:
            return None
        f_best, active = projected
        moved = f_best - f
        y = y + self._y_from_f.dot(moved)
        if self._level != "b":
            nu = nu - self.factorisation.Q[n_a:].T @ (self._F @ moved)
        return Iterate(stack.mode, y, nu), stack.mode.active_set(active)

    def _project(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The forces nearest to f that obey the friction rows, and which rows are active."""
        try:
            self._qp.update(f=-(self._F @ f))
            nearest, _, flag, info = self._qp.solve()
        except RuntimeError:  # how daqp says that it cannot
            return None
        return (np.asarray(nearest), np.flatnonzero(info["lam"])) if flag == 1 else None

    def _gradient(
        self, iterate: Iterate, residual: np.ndarray, model: WholeBodyModel, now: Kinematics
    ) -> np.ndarray:
        """H y − Aᵀ s − Eᵀ ν at the present state, (n,); level B with adjoint has a stale Aᵀ."""
        stack = self._stack
        n_a = stack.layout.n_accelerations
        nu = iterate.nu
        multipliers = RowMultipliers.zero(model.nv)
        multipliers.dynamics += nu[:N_DYNAMICS]
        gradient = np.empty_like(iterate.y)
        for k, foot in enumerate(stack.mode.feet):
            start = N_DYNAMICS + ROWS_PER_CONTACT * k
            multipliers.soles[foot] = nu[start : start + ROWS_PER_CONTACT]
            lever = stack.contacts.wrench_map[foot].T @ model.sole_motion_of_base(
                foot, now, nu[:N_DYNAMICS]
            )
            f = iterate.y[_forces(n_a, k)]
            gradient[_forces(n_a, k)] = stack.force_weight * f + lever
        if self._level == "c":
            stack.add_task_multipliers(residual, multipliers)
        gradient[:n_a] = -model.transposed(now.q, multipliers)
        if self._level == "b_adjoint":
            gradient[:n_a] -= self.factorisation.A.T @ residual[stack.task_rows]
        return gradient


_SENSE = np.zeros(64, dtype=np.int32)


def _spd_inverse(matrix: np.ndarray) -> np.ndarray:
    np.linalg.cholesky(matrix)  # raises LinAlgError if it is not positive definite
    inverse = np.linalg.inv(matrix)
    if not all_finite(inverse):
        raise np.linalg.LinAlgError("not positive definite")
    whole: np.ndarray = 0.5 * (inverse + inverse.T)
    return whole


def _forces(n_a: int, k: int) -> slice:
    return slice(n_a + k * FORCES_PER_FOOT, n_a + (k + 1) * FORCES_PER_FOOT)
