"""A stale factorisation corrected by exact residuals: chord steps, and the active set re-decided.

In one contact mode, without friction rows, the optimum of the whole-body QP is linear in (g, e).
With H = blockdiag(AᵀA, ω_f I) and g = (Aᵀs, 0),

    [ H  −Eᵀ ] [ y ]   [ g ]
    [ E   0  ] [ ν ] = [ e ],

    [ y ]   [  P   Q ] [ g ]
    [ ν ] = [ −Qᵀ  T ] [ e ].

The edge computes P, Q, T at the posture it knows. The robot, at its own state, takes the exact
residuals at its previous solution and corrects it by these stale blocks. The friction rows C f ≥ l
are constant, so it decides the active set itself. Level `b` keeps the stale trade-off between
tasks. Level `c` takes the exact gradient too and has the fresh optimum as its fixed point. For the
terms of multi-level real-time iterations see Bock, Diehl, Kostina & Schlöder 2007; Kirches,
Wirsching, Bock & Schlöder 2012. `docs/locally-corrected.md` derives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from shared.wbc.answer import Factorisation
from shared.wbc.contacts import FORCES_PER_FOOT, ContactMode
from shared.wbc.finite import all_finite
from shared.wbc.limits import Limits
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
        """Return the zero iterate. One step of level `b` from it is the stale optimum with a fresh
        active set.
        """
        return Iterate(
            stack.mode, np.zeros(stack.layout.n_unknowns), np.zeros(stack.equality_rows.stop)
        )

    def in_mode(self, stack: Stack, n_a: int) -> Iterate:
        """The start in another contact mode: the same accelerations, and the forces of feet that
        stay loaded.
        """
        iterate = Iterate.zero(stack)
        iterate.y[:n_a] = self.y[:n_a]
        for k, foot in enumerate(stack.mode.feet):
            if foot in self.mode.feet:
                j = self.mode.feet.index(foot)
                iterate.y[_forces(n_a, k)] = self.y[_forces(n_a, j)]
        return iterate


class Corrector:
    """Chord steps with one factorisation. It is made when the factorisation arrives, and used in
    every tick.

    Raises `numpy.linalg.LinAlgError` if the forces' block of P is not positive definite.
    `limit_rows` D (n_x, n) at the factorised posture, for a stack with limits. Not shared between
    threads: the small QPs keep their active sets from one step to the next.
    """

    def __init__(
        self,
        stack: Stack,
        factorisation: Factorisation,
        *,
        level: str,
        limit_rows: np.ndarray | None = None,
    ) -> None:
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
        no_bound, sense = np.full(len(l), 1e30), np.zeros(len(l), dtype=np.int32)
        self._qp.setup(self._F, np.zeros(len(self._F)), C, no_bound, l, sense)
        if self._project(np.zeros(len(self._F))) is None:
            raise np.linalg.LinAlgError("the forces' block of P is not definite enough")
        self._limited: LimitedProjection | None = None
        if stack.limits is not None and limit_rows is not None:
            self._limited = LimitedProjection(stack, stack.limits, factorisation, limit_rows)

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

        `residual` is b − M y at the present state, `now` the kinematics there.
        """
        stack = self._stack
        n_a, n_rows = stack.layout.n_accelerations, stack.layout.n_rows
        y, nu = iterate.y, iterate.nu
        if self._level == "b":
            moved = self._K.dot(residual[: n_rows - 1]) - self._regularisation.dot(y[n_a:])
            y = y + (moved if relaxation == 1.0 else relaxation * moved)
        else:
            gradient = self._gradient(iterate, residual, model, now)
            P, Q, T = self.factorisation.P, self.factorisation.Q, self.factorisation.T
            equalities = residual[stack.equality_rows]
            y = y + relaxation * (Q @ equalities - P @ gradient)
            nu = nu + relaxation * (Q.T @ gradient + T @ equalities)
        if not all_finite(y):
            return None
        corrected = self._obey_friction(Iterate(stack.mode, y, nu))
        if corrected is None or self._limited is None:
            return corrected
        misses = residual[n_rows:]
        if self._limited.holds(corrected[0].y - iterate.y, misses):
            return corrected
        limited = self._limited.obey(y, y - iterate.y, misses)
        if limited is None:
            return None
        moved, multipliers, active = limited
        nu = nu - self.factorisation.Q.T @ multipliers
        return Iterate(stack.mode, y + moved, nu), stack.mode.active_set(active)

    def _obey_friction(self, iterate: Iterate) -> tuple[Iterate, int] | None:
        """The nearest iterate that obeys the friction rows, and its active set as a bit mask."""
        stack, y, nu = self._stack, iterate.y, iterate.nu
        n_a = stack.layout.n_accelerations
        f = y[n_a:]
        C, l = stack.contacts.C, stack.contacts.l  # noqa: E741
        if (C.dot(f) >= l).all():
            # Forces that obey the friction rows are the nearest that do.
            return iterate, 0
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
        """The forces nearest to f that obey the friction rows, and the active rows."""
        try:
            self._qp.update(f=-(self._F @ f))
            nearest, _, flag, info = self._qp.solve()
        except RuntimeError:  # daqp reports a failure by this error
            return None
        return (np.asarray(nearest), np.flatnonzero(info["lam"])) if flag == 1 else None

    def _gradient(
        self, iterate: Iterate, residual: np.ndarray, model: WholeBodyModel, now: Kinematics
    ) -> np.ndarray:
        """H y − Aᵀ s − Eᵀ ν at the present state, (n,); level `b_adjoint` has a stale Aᵀ."""
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
            stack.add_task_multipliers(residual, multipliers, now)
        gradient[:n_a] = -model.transposed(now.q, multipliers)
        if self._level == "b_adjoint":
            gradient[:n_a] -= self.factorisation.A.T @ residual[stack.task_rows]
        return gradient


class LimitedProjection:
    """The nearest solution that obeys the friction rows and the robot's own limits.

    The limited quantities and the forces, w = (x, f), move in the metric of (W P Wᵀ + slack)⁻¹ with
    W = (D; 0 I), and y moves by P Wᵀ times as much. x is exact at the iterate, D is stale.
    """

    def __init__(
        self, stack: Stack, limits: Limits, factorisation: Factorisation, D: np.ndarray
    ) -> None:
        n_a, (n_x, n) = stack.layout.n_accelerations, D.shape
        P, C, l = factorisation.P, stack.contacts.C, stack.contacts.l  # noqa: E741
        self._n_x, self._n_a, self._C, self._l = n_x, n_a, C, l
        self._D = np.ascontiguousarray(D)
        # Joint accelerations are entries of y, so that only the rows of torques need a product.
        n_joints = n_x // 2
        self._D_torque, self._joints = self._D[:n_joints], slice(n_a - n_joints, n_a)
        self._moved, self._beyond = np.zeros(n_x), np.zeros((2, n_x))
        self._of_torques, self._of_joints = self._moved[:n_joints], self._moved[n_joints:]
        self._below, self._above = self._beyond
        self._flat = self._beyond.reshape(-1)
        W = np.vstack([D, np.eye(n)[n_a:]])
        slack = np.full(len(W), _ROUNDING * np.diag(P)[n_a:].max())
        slack[:n_x] = limits.slack
        compliance = W @ P @ W.T
        self._metric = _spd_inverse(0.5 * (compliance + compliance.T) + np.diag(slack))
        self._gradient_from_w = np.ascontiguousarray(W.T @ self._metric)
        self._y_from_w = np.ascontiguousarray(P @ self._gradient_from_w)
        # The quantities are bounds on variables; the friction rows follow.
        n_rows = n_x + len(l)
        self._lower, self._upper = np.full(n_rows, -1e30), np.full(n_rows, 1e30)
        rows = np.hstack([np.zeros((len(l), n_x)), C])
        self._qp = daqp.Model()
        sense = np.zeros(n_rows, dtype=np.int32)
        self._qp.setup(self._metric, np.zeros(len(W)), rows, self._upper, self._lower, sense)

    def holds(self, moved: np.ndarray, misses: np.ndarray) -> bool:
        """Return whether the limits hold after y has `moved` from the iterate that has these
        misses.
        """
        self._D_torque.dot(moved, self._of_torques)
        self._of_joints[:] = moved[self._joints]
        np.subtract(misses[: self._n_x], self._moved, self._below)
        np.add(misses[self._n_x :], self._moved, self._above)
        return bool(self._flat[self._flat.argmax()] <= 0.0)

    def obey(
        self, y: np.ndarray, moved: np.ndarray, misses: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The move of y, the gradient Wᵀ λ that moves it, and the active friction rows.

        `moved` is how far y is from the iterate at which the `misses` are exact.
        """
        n_x = self._n_x
        of_x = self._D.dot(moved)
        np.subtract(misses[:n_x], of_x, self._lower[:n_x])
        np.negative(misses[n_x:] + of_x, self._upper[:n_x])
        np.subtract(self._l, self._C.dot(y[self._n_a :]), self._lower[n_x:])
        try:
            self._qp.update(bupper=self._upper, blower=self._lower)
            w, _, flag, info = self._qp.solve()
        except RuntimeError:  # daqp reports a failure by this error
            return None
        if flag != 1:
            return None
        w, multipliers = np.asarray(w), np.asarray(info["lam"])
        active = np.flatnonzero(multipliers[n_x:])
        return self._y_from_w.dot(w), self._gradient_from_w.dot(w), active


# The slack of a friction row, as a part of the forces' block of P. A row may yield by it, because
# the wire rounds P to single precision and W P Wᵀ has only as many dimensions as y has freedoms.
_ROUNDING = 3e-7


def _spd_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix by NumPy, because a robot loads no SciPy."""
    np.linalg.cholesky(matrix)  # raises LinAlgError if it is not positive definite
    inverse = np.linalg.inv(matrix)
    if not all_finite(inverse):
        raise np.linalg.LinAlgError("not positive definite")
    whole: np.ndarray = 0.5 * (inverse + inverse.T)
    return whole


def _forces(n_a: int, k: int) -> slice:
    return slice(n_a + k * FORCES_PER_FOOT, n_a + (k + 1) * FORCES_PER_FOOT)
