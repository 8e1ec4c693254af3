"""The QP at one state, its active set, and the projector A† of that set: y = A† b, Eq. (4).

The tasks act on a only and the friction rows on f only, so a is eliminated first. For given f,

    a = P_a Aᵀ s + Q (e − E_f f),   S = E_a H⁻¹ E_aᵀ,  Q = H⁻¹ E_aᵀ S⁻¹,  P_a = H⁻¹ − Q E_a H⁻¹

with H = Aᵀ A (the weights are in A). What remains is a QP in f alone (n_f = 24 or 12):

    min ½ fᵀ F f − (R b)ᵀ f   s.t.  C f ≥ l
    F = ω_f I + E_fᵀ S⁻¹ E_f,   R b = E_fᵀ S⁻¹ (e − E_a H⁻¹ Aᵀ s)

Its active rows turn into equalities, f becomes linear in b, and a follows. Exact: no term is
dropped. `docs/maths.md` derives it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from shared.wbc.contacts import ContactMode
from shared.wbc.qp import QpSolution, QpSolver, QpStatus, QuadraticProgram
from shared.wbc.stack import N_DYNAMICS, Stack, StackMatrices


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
class CondensedQp:
    """The QP in f, and what is needed to go back to a; see the equations above."""

    problem: QuadraticProgram
    R: np.ndarray
    F_inverse: np.ndarray
    a_from_b: np.ndarray
    a_from_f: np.ndarray


def condense(stack: Stack, matrices: StackMatrices, b: np.ndarray) -> CondensedQp:
    """Eliminate a. Raises `numpy.linalg.LinAlgError` if the rows are dependent or not finite."""
    E_a, E_f, A = matrices.E_a, matrices.E_f, matrices.A
    H_inverse = spd_inverse(A.T @ A)
    E_H = E_a @ H_inverse
    S_inverse = spd_inverse(E_H @ E_a.T)
    Q = E_H.T @ S_inverse
    P_A = (H_inverse - Q @ E_H) @ A.T
    # Only the six dynamics rows of E touch f.
    F_S = E_f.T @ S_inverse[:N_DYNAMICS]
    F = F_S[:, :N_DYNAMICS] @ E_f
    F.flat[:: F.shape[0] + 1] += stack.force_weight
    a_from_f = -Q[:, :N_DYNAMICS] @ E_f
    a_from_b = np.concatenate([Q, P_A], axis=1)
    R = np.concatenate([F_S, a_from_f.T @ A.T], axis=1)
    problem = QuadraticProgram(H=F, g=-(R @ b[:-1]), C=stack.contacts.C, l=stack.contacts.l)
    return CondensedQp(problem, R, spd_inverse(F), a_from_b, a_from_f)


def factorise(stack: Stack, condensed: CondensedQp, active: np.ndarray) -> Projector:
    """A† with the given rows of C held at equality, from the condensed QP at the same state."""
    n_a, n_f = stack.layout.n_accelerations, stack.layout.n_forces
    A_dagger = np.empty((stack.layout.n_rows, n_a + n_f)).T
    f_from_b = A_dagger[n_a:]
    N = condensed.F_inverse
    f_from_b[:, -1] = 0.0
    if active.size:
        C_N = stack.contacts.C[active] @ N
        W_inverse = spd_inverse(C_N @ stack.contacts.C[active].T)
        f_from_l = C_N.T @ W_inverse
        N = N - f_from_l @ C_N
        f_from_b[:, -1] = f_from_l @ stack.contacts.l[active]
    f_from_b[:, :-1] = N @ condensed.R
    A_dagger[:n_a] = condensed.a_from_f @ f_from_b
    A_dagger[:n_a, :-1] += condensed.a_from_b
    return Projector(mode=stack.mode, A_dagger=np.ascontiguousarray(A_dagger), active=active)


@dataclass(frozen=True, slots=True)
class WholeBodySolution:
    """Outcome of a full solve; `projector` is None unless `status` is SOLVED."""

    status: QpStatus
    projector: Projector | None
    iterations: int


def solve(
    stack: Stack,
    matrices: StackMatrices,
    b: np.ndarray,
    *,
    solver: QpSolver,
    warm_active: np.ndarray | None = None,
) -> WholeBodySolution:
    """Find the optimal active set at one state and the projector of that set.

    Never raises: a problem that cannot be solved comes back with the name of what went wrong.
    """
    try:
        condensed = condense(stack, matrices, b)
        solution: QpSolution = solver.solve(condensed.problem, warm_active=warm_active)
        if solution.status is not QpStatus.SOLVED:
            return WholeBodySolution(solution.status, None, solution.iterations)
        projector = factorise(stack, condensed, solution.active)
    except np.linalg.LinAlgError:
        return WholeBodySolution(QpStatus.NOT_FINITE, None, 0)
    return WholeBodySolution(solution.status, projector, solution.iterations)


def full_problem(stack: Stack, matrices: StackMatrices, b: np.ndarray) -> QuadraticProgram:
    """The QP of Eq. (2) in y = (a, f), not condensed: the reference of tests and benchmarks."""
    n_a, n_f = stack.layout.n_accelerations, stack.layout.n_forces
    H = np.zeros((n_a + n_f, n_a + n_f))
    H[:n_a, :n_a] = matrices.A.T @ matrices.A
    H[n_a:, n_a:] = stack.force_weight * np.eye(n_f)
    g = np.zeros(n_a + n_f)
    g[:n_a] = -matrices.A.T @ b[stack.task_rows]
    E = np.zeros((matrices.E_a.shape[0], n_a + n_f))
    E[:, :n_a] = matrices.E_a
    E[:N_DYNAMICS, n_a:] = matrices.E_f
    C = np.hstack([np.zeros((stack.contacts.C.shape[0], n_a)), stack.contacts.C])
    return QuadraticProgram(H=H, g=g, C=C, l=stack.contacts.l, E=E, e=b[stack.equality_rows])


def spd_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix by its Cholesky factor."""
    factor, info = dpotrf(matrix, lower=1, clean=1)
    if info == 0:
        inverse, info = dpotri(factor, lower=1, overwrite_c=1)
    if info != 0 or not math.isfinite(inverse[-1, -1]):
        raise np.linalg.LinAlgError("not positive definite")
    inverse.reshape(-1, order="F")[:: matrix.shape[0] + 1] *= 0.5
    whole: np.ndarray = inverse + inverse.T
    return whole
