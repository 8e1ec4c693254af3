"""The QP at one state, its active set, and the projector A† of that set: y = A† b, Eq. (4).

The active friction rows are held at equality. The QP then asks for the shortest z that obeys B z =
Z b (`least_norm`), in which the tasks and √ω_f f have weight one:

    z = Bᵀ S⁻¹ Z b,   S = B Bᵀ        a = T (s₁ + ρ₁),   f from z.

All are linear in b: the rows of A†. S has a row for each row of E, of a swing foot and of C_𝒜, and
is the only matrix to factorise. The active set is that of the last state, if it proves to be
optimal. Otherwise a solver finds it, in f alone (n_f = 24 or 12). Exact: no term is dropped.
`docs/maths.md` derives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtri, dtrtrs

from shared.wbc.answer import Projector
from shared.wbc.least_norm import LeastNorm
from shared.wbc.qp import QpSolver, QpStatus, QuadraticProgram
from shared.wbc.stack import N_DYNAMICS, Stack, StackMatrices

# How clearly a set must be optimal to be taken without asking a solver [N]. Well above the solvers'
# own tolerances: they would find the same set, so an answer does not depend on the states before.
_CLEARLY = 1e-4


def condense(stack: Stack, problem: LeastNorm, b: np.ndarray) -> QuadraticProgram:
    """The QP in f alone, ρ eliminated. Raises `numpy.linalg.LinAlgError` if rows are dependent."""
    form, rows = stack.least_norm_form, problem.rows
    B_rho = np.concatenate([rows[:, form.rho_1], rows[:, form.rho_2]], axis=1)
    right = np.column_stack([rows[:, form.f], rows[:, form.b] @ b])
    whitened, _ = dtrtrs(_cholesky(B_rho @ B_rho.T), right, lower=1)
    B_f, e = whitened[:, :-1], whitened[:, -1]
    F = stack.force_weight * (np.eye(B_f.shape[1]) + B_f.T @ B_f)
    g = (B_f.T @ e) / -form.force_scale
    return QuadraticProgram(H=F, g=g, C=stack.contacts.C, l=stack.contacts.l)


@dataclass(frozen=True, slots=True)
class HeldRows:
    """The optimum with some rows of C held at equality, for any b.

    The multipliers of these rows are λ = `multipliers` b, (k, n_rows). `factor` (k, k) is their
    block of the Cholesky factor of S.
    """

    projector: Projector
    multipliers: np.ndarray
    factor: np.ndarray


def hold(stack: Stack, problem: LeastNorm, active: np.ndarray) -> HeldRows:
    """A† with the given rows of C held. Raises `numpy.linalg.LinAlgError` as `condense` does."""
    form, rows, m = stack.least_norm_form, problem.rows, len(problem.rows)
    if active.size:
        rows = np.concatenate([rows, form.friction_rows[active]])
    B = rows[:, form.z]
    factor = _cholesky(B @ B.T)
    multipliers, _ = dpotrs(factor, rows[:, form.b], lower=1)
    z = B.T @ multipliers
    n_a, n, n_rows = stack.layout.n_accelerations, stack.layout.n_unknowns, z.shape[1]
    # s₁ + ρ₁: a 1 for each determining row.
    first = stack.equality_rows.stop
    z.reshape(-1)[first : first + n_a * (n_rows + 1) : n_rows + 1] += 1.0
    A_dagger = z[:n]
    A_dagger[:n_a] = problem.T @ A_dagger[:n_a]
    A_dagger[n_a:] *= form.force_scale
    return HeldRows(Projector(stack.mode, A_dagger, active), multipliers[m:], factor[m:, m:])


def is_optimal(stack: Stack, held: HeldRows, b: np.ndarray) -> bool:
    """Return whether, by a clear margin, no free row is violated and no held one pulls."""
    contacts, k = stack.contacts, len(held.factor)
    f = held.projector.A_dagger[stack.layout.n_accelerations :] @ b
    free = int(np.count_nonzero(contacts.C @ f - contacts.l > _CLEARLY))
    if free + k < len(contacts.l) or k == 0:
        return free == len(contacts.l)
    inverse, _ = dtrtri(held.factor, lower=1)
    # The violation of each row if it alone were released: λᵢ over (S⁻¹)ᵢᵢ.
    released = held.multipliers @ b / np.square(inverse).sum(axis=0)
    return bool((released > _CLEARLY).all())


@dataclass(frozen=True, slots=True)
class WholeBodySolution:
    """Outcome of a full solve; `projector` is None unless `status` is SOLVED.

    `iterations` of the solver, 0 if it was not needed.
    """

    status: QpStatus
    projector: Projector | None
    iterations: int


def solve(
    stack: Stack,
    matrices: StackMatrices,
    b: np.ndarray,
    *,
    solver: QpSolver,
    likely_active: np.ndarray | None = None,
) -> WholeBodySolution:
    """Find the optimal active set at one state and the projector of that set.

    `likely_active`, as of the last state, saves the solver if it proves to be optimal. Never
    raises: a problem that cannot be solved comes back with the name of what went wrong.
    """
    try:
        problem = stack.least_norm(matrices)
        if likely_active is not None:
            held = hold(stack, problem, likely_active)
            if is_optimal(stack, held, b):
                return WholeBodySolution(QpStatus.SOLVED, held.projector, 0)
        solution = solver.solve(condense(stack, problem, b))
        if solution.status is not QpStatus.SOLVED:
            return WholeBodySolution(solution.status, None, solution.iterations)
        projector = hold(stack, problem, solution.active).projector
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


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    # Its transpose, the same, is in the order of LAPACK.
    factor, info = dpotrf(matrix.T, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("not positive definite")
    lower: np.ndarray = factor
    return lower
