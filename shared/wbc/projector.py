"""The QP at one state, its active set, and the projector A† of that set: y = A† b, Eq. (4).

The active friction rows are held at equality. The QP then asks for the shortest z that obeys B z =
Z b (`least_norm`), in which the tasks and √ω_f f have weight one:

    z = Bᵀ S⁻¹ Z b,   S = B Bᵀ        a = T (s₁ + ρ₁),   f from z.

All are linear in b: the rows of A†. S has a row for each row of E, of a swing foot and of C_𝒜, and
is the only matrix to factorise. The active set is that of the last state, if it proves to be
optimal. Otherwise a solver finds it, in f alone (n_f = 24 or 12). Exact: no term is dropped.

An active limit of the robot is a row of the same kind. It may be missed at a price, which adds 1/ω
to its diagonal entry of S. Only the limits that a solution would break enter the solver's QP. A
robot with limits gets a projector that leaves all inequality rows open. The robot decides on them.
`docs/maths.md` derives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtri, dtrtrs

from shared.wbc.answer import Openness, Projector, no_rows
from shared.wbc.contacts import ContactMode
from shared.wbc.least_norm import LeastNorm
from shared.wbc.qp import QpSolver, QpStatus, QuadraticProgram
from shared.wbc.stack import N_DYNAMICS, Stack, StackMatrices

# The margin by which a set must be optimal to be taken without a solver [N]. It is well above the
# solvers' own tolerances. They would find the same set, so an answer does not depend on earlier
# states.
_CLEARLY = 1e-4
# A limited quantity beyond its bound by more than this is no rounding error, [1] or [rad/s²]. The
# number is the maximum number of solves with further limits.
_BEYOND, _MAX_ROUNDS = 1e-7, 20


def condense(
    stack: Stack, problem: LeastNorm, b: np.ndarray, quantities: np.ndarray | None = None
) -> QuadraticProgram:
    """The QP in f alone, ρ eliminated. Raises `numpy.linalg.LinAlgError` if rows are dependent.

    With limits on some `quantities` (k,), rows of D, the QP is in (f, t) with t = √ω D y of these.
    The rows of C are followed by k lower and k upper bounds of t.
    """
    form, rows = stack.least_norm_form, problem.rows
    B_rho = np.concatenate([rows[:, form.rho_1], rows[:, form.rho_2]], axis=1)
    right = np.column_stack([rows[:, form.f], rows[:, form.b] @ b[: stack.layout.n_rows]])
    if quantities is not None and len(quantities):
        return _condense_limited(stack, problem, b, quantities, B_rho, right)
    whitened, _ = dtrtrs(_cholesky(B_rho @ B_rho.T), right, lower=1)
    B_f, e = whitened[:, :-1], whitened[:, -1]
    F = stack.force_weight * (np.eye(B_f.shape[1]) + B_f.T @ B_f)
    g = (B_f.T @ e) / -form.force_scale
    return QuadraticProgram(H=F, g=g, C=stack.contacts.C, l=stack.contacts.l)


def _condense_limited(
    stack: Stack,
    problem: LeastNorm,
    b: np.ndarray,
    quantities: np.ndarray,
    B_rho: np.ndarray,
    right: np.ndarray,
) -> QuadraticProgram:
    """`condense` with rows D y − t/√ω = 0 that may be missed, so that 1/ω adds to the diagonal."""
    form, m, k = stack.least_norm_form, len(B_rho), len(quantities)
    rows = problem.limit_rows(form, quantities)
    of_quantities = np.concatenate([rows[:, form.rho_1], rows[:, form.rho_2]], axis=1)
    B_rho = np.concatenate([B_rho, of_quantities])
    of_b = rows[:, form.b] @ b[: stack.layout.n_rows]
    n_f = stack.contacts.n_forces
    whitened = np.zeros((m + k, n_f + k + 1))
    whitened[:m, :n_f], whitened[:m, -1] = right[:, :-1], right[:, -1]
    whitened[m:, :n_f], whitened[m:, -1] = rows[:, form.f], of_b
    slack = stack.slack[quantities]
    unit = np.sqrt(slack)
    whitened[m:, n_f:-1] = -np.diag(unit)
    S = B_rho @ B_rho.T
    S.flat[m * (m + k + 1) :: m + k + 1] += slack
    whitened, _ = dtrtrs(_cholesky(S), whitened, lower=1)
    X, e = whitened[:, :-1], whitened[:, -1]
    X[:, :n_f] /= form.force_scale
    H = X.T @ X
    H.flat[: n_f * (n_f + k + 1) : n_f + k + 1] += stack.force_weight
    C, l = stack.contacts.C, stack.contacts.l  # noqa: E741
    identity, n_x = np.eye(k), len(problem.D)
    misses = b[stack.layout.n_rows :]
    bounds = np.zeros((len(l) + 2 * k, n_f + k))
    bounds[: len(l), :n_f] = C
    bounds[len(l) : len(l) + k, n_f:] = identity
    bounds[len(l) + k :, n_f:] = -identity
    lower = np.concatenate([l, misses[quantities] / unit, misses[n_x + quantities] / unit])
    return QuadraticProgram(H=H, g=-(X.T @ e), C=bounds, l=lower)


@dataclass(frozen=True, slots=True)
class HeldRows:
    """The optimum with some rows of C and some limits held at equality, for any b.

    y is `A_dagger` (n, n_rows + k_x) times the entries of b that have a column: the layout's rows,
    then the active `limits` (k_x,). The multipliers of the rows of C, `active`, and of the limits
    are λ = `multipliers` (k, n_rows + k_x) times the same entries. `factor` (k, k) is their block
    of the Cholesky factor of S. `D` as in `LeastNorm`.
    """

    mode: ContactMode
    A_dagger: np.ndarray
    active: np.ndarray
    limits: np.ndarray
    multipliers: np.ndarray
    factor: np.ndarray
    D: np.ndarray

    @property
    def projector(self) -> Projector:
        """The projector of the held rows, for a robot without limits."""
        return Projector(self.mode, self.A_dagger, self.active)

    def apply(self, b: np.ndarray) -> np.ndarray:
        """The optimum y (n,) with these rows held."""
        y: np.ndarray = self.A_dagger.dot(self.entries_of(b))
        return y

    def entries_of(self, b: np.ndarray) -> np.ndarray:
        """The entries of b that have a column."""
        k = len(self.limits)
        n_rows = self.A_dagger.shape[1] - k
        if len(b) > n_rows:
            b = np.concatenate([b[:n_rows], b[n_rows + self.limits]]) if k else b[:n_rows]
        return b


def hold(
    stack: Stack, problem: LeastNorm, active: np.ndarray, limits: np.ndarray | None = None
) -> HeldRows:
    """A† with the given rows of C, and the given limits, held.

    Raises `numpy.linalg.LinAlgError` as `condense` does.
    """
    form, rows, m = stack.least_norm_form, problem.rows, len(problem.rows)
    if active.size:
        rows = np.concatenate([rows, form.friction_rows[active]])
    limits = no_rows() if limits is None else limits
    k = len(limits)
    if k:
        rows = _with_limits(stack, problem, rows, limits)
    B = rows[:, form.z]
    S = B @ B.T
    if k:
        n = len(S)
        S.flat[(n - k) * (n + 1) :: n + 1] += stack.slack[limits % len(problem.D)]
    factor = _cholesky(S)
    multipliers, _ = dpotrs(factor, rows[:, form.b.start :], lower=1)
    A_dagger = _y_from(stack, problem, B.T @ multipliers)
    mode, of_rows = stack.mode, factor[m:, m:]
    return HeldRows(mode, A_dagger, active, limits, multipliers[m:], of_rows, problem.D)


def leave_open(
    stack: Stack, problem: LeastNorm, active: np.ndarray, limits: np.ndarray
) -> Projector:
    """A† of the equalities alone, and the push of the given limits and of each contact force.

    `active` are the rows of C that are active at the optimum. Raises as `condense` does.
    """
    form, m, n_f, k = stack.least_norm_form, len(problem.rows), stack.contacts.n_forces, len(limits)
    n_rows, n_x = stack.layout.n_rows, len(problem.D)
    B = np.zeros((m + k + n_f, form.z.stop))
    B[:m] = problem.rows[:, form.z]
    signs = np.where(limits < n_x, 1.0, -1.0)[:, np.newaxis]
    B[m : m + k] = signs * problem.limit_rows(form, limits % n_x)[:, form.z]
    B[m + k :, form.f] = form.force_scale * np.eye(n_f)
    S = B @ B.T
    n = len(S)
    S.flat[m * (n + 1) : (m + k) * (n + 1) : n + 1] += stack.slack[limits % n_x]
    # The right-hand sides of the equalities, for b and for the pushes.
    asked = np.concatenate([problem.rows[:, form.b], -S[:m, m:]], axis=1)
    factor = _cholesky(S)
    multipliers, _ = dpotrs(factor[:m, :m], asked, lower=1)
    z = B[:m].T @ multipliers
    z[:, n_rows:] += B[m:].T
    y = _y_from(stack, problem, z)
    # L Lᵀ is the Schur complement of the equalities in S. u = Lᵀ λ has unit weight.
    of_pushes = factor[m:, m:]
    push, _ = dtrtrs(of_pushes, y[:, n_rows:].T, lower=1)
    opened = Openness(limits, np.ascontiguousarray(push.T), of_pushes[:k, :k])
    return Projector(stack.mode, np.ascontiguousarray(y[:, :n_rows]), active, opened)


def _y_from(stack: Stack, problem: LeastNorm, z: np.ndarray) -> np.ndarray:
    """The rows of y, computed from the rows of z, whose first columns belong to b. Overwrites z."""
    n_a, n, n_columns = stack.layout.n_accelerations, stack.layout.n_unknowns, z.shape[1]
    # s₁ + ρ₁: a 1 for each determining row.
    first = stack.equality_rows.stop
    z.reshape(-1)[first : first + n_a * (n_columns + 1) : n_columns + 1] += 1.0
    y = z[:n]
    y[:n_a] = problem.T @ y[:n_a]
    y[n_a:] *= stack.least_norm_form.force_scale
    return y


def _with_limits(
    stack: Stack, problem: LeastNorm, rows: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """The rows (B, Z), followed by the rows of active limits, ± D y = entry of b, with a new column
    for each entry.
    """
    form, n_x, k = stack.least_norm_form, len(problem.D), len(limits)
    signs = np.where(limits < n_x, 1.0, -1.0)[:, np.newaxis]
    wider = np.zeros((len(rows) + k, rows.shape[1] + k))
    wider[: len(rows), : rows.shape[1]] = rows
    wider[len(rows) :, : rows.shape[1]] = signs * problem.limit_rows(form, limits % n_x)
    wider[len(rows) :, rows.shape[1] :] = np.eye(k)
    return wider


def is_optimal(stack: Stack, held: HeldRows, b: np.ndarray) -> bool:
    """Return whether no free row is violated and no held row pulls, by a clear margin."""
    contacts, k = stack.contacts, len(held.factor)
    y = held.apply(b)
    f = y[stack.layout.n_accelerations :]
    free = int(np.count_nonzero(contacts.C @ f - contacts.l > _CLEARLY))
    within = _misses(held.D, y, b[stack.layout.n_rows :]) < -_CLEARLY
    free += int(np.count_nonzero(within)) - int(np.count_nonzero(within[held.limits]))
    n_inequalities = len(contacts.l) + len(within)
    if free + k < n_inequalities or k == 0:
        return free == n_inequalities
    inverse, _ = dtrtri(held.factor, lower=1)
    # The violation of each row if it alone were released: λᵢ over (S⁻¹)ᵢᵢ.
    released = held.multipliers @ held.entries_of(b) / np.square(inverse).sum(axis=0)
    return bool((released > _CLEARLY).all())


def _misses(D: np.ndarray, y: np.ndarray, of_b: np.ndarray) -> np.ndarray:
    """The misses of the limited quantities at y, from the misses at y = 0."""
    if not len(of_b):
        return of_b
    x = D @ y
    misses: np.ndarray = of_b + np.concatenate([-x, x])
    return misses


@dataclass(frozen=True, slots=True)
class WholeBodySolution:
    """Outcome of a full solve; `projector` is None unless `status` is SOLVED.

    `iterations` of the solver, 0 if it was not needed. `held` are the rows of the optimum.
    """

    status: QpStatus
    projector: Projector | None
    iterations: int
    held: HeldRows | None = None


def solve(
    stack: Stack,
    matrices: StackMatrices,
    b: np.ndarray,
    *,
    solver: QpSolver,
    likely_active: np.ndarray | None = None,
    likely_limits: np.ndarray | None = None,
) -> WholeBodySolution:
    """Find the optimal active set at one state and the projector of that set.

    `likely_active` and `likely_limits` are sets to try first, for example those of the last state.
    If they are optimal, no solver runs. A limit enters the QP only if the solution without it
    violates it. Never raises: the status of an unsolved problem names the reason.
    """
    iterations = 0
    try:
        problem = stack.least_norm(matrices)
        quantities = no_rows()
        if likely_active is not None:
            held = hold(stack, problem, likely_active, likely_limits)
            if is_optimal(stack, held, b):
                return _solved(stack, problem, held, b, iterations=0)
        if likely_limits is not None and len(likely_limits):
            quantities = np.unique(likely_limits % len(problem.D))
        for _ in range(_MAX_ROUNDS):
            solution = solver.solve(condense(stack, problem, b, quantities))
            iterations += solution.iterations
            if solution.status is not QpStatus.SOLVED:
                return WholeBodySolution(solution.status, None, iterations)
            held = hold(stack, problem, *_active_sets(stack, problem, solution.active, quantities))
            beyond = _quantities_beyond(stack, held, b)
            if np.isin(beyond, quantities).all():
                return _solved(stack, problem, held, b, iterations=iterations)
            quantities = np.union1d(quantities, beyond)
    except np.linalg.LinAlgError:
        return WholeBodySolution(QpStatus.NOT_FINITE, None, 0)
    return WholeBodySolution(QpStatus.ITERATION_LIMIT, None, iterations)


def _solved(
    stack: Stack, problem: LeastNorm, held: HeldRows, b: np.ndarray, *, iterations: int
) -> WholeBodySolution:
    """The optimum. With limits of the robot's own, its projector leaves all inequalities open."""
    projector = held.projector
    if stack.limits is not None:
        misses = _misses(held.D, held.apply(b), b[stack.layout.n_rows :])
        near = stack.limits.near(misses, held.limits)
        projector = leave_open(stack, problem, held.active, near)
    return WholeBodySolution(QpStatus.SOLVED, projector, iterations, held)


def _active_sets(
    stack: Stack, problem: LeastNorm, active: np.ndarray, quantities: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The active rows of C, and the active limits, of a solution of the QP in (f, t)."""
    first = len(stack.contacts.l)
    bounds = active[active >= first] - first
    k, n_x = len(quantities), len(problem.D)
    lower, upper = bounds[bounds < k], bounds[bounds >= k] - k
    limits = np.concatenate([quantities[lower], n_x + quantities[upper]])
    return active[active < first], limits


def _quantities_beyond(stack: Stack, held: HeldRows, b: np.ndarray) -> np.ndarray:
    """The limited quantities that are beyond a bound at the optimum of the held rows."""
    misses = _misses(held.D, held.apply(b), b[stack.layout.n_rows :])
    return np.flatnonzero((misses.reshape(2, -1) > _BEYOND).any(axis=0))


def full_problem(stack: Stack, matrices: StackMatrices, b: np.ndarray) -> QuadraticProgram:
    """The QP of Eq. (2) in y = (a, f), not condensed: the reference of tests and benchmarks.

    With limits, their violations (n_x,) follow y.
    """
    n_a, n_f = stack.layout.n_accelerations, stack.layout.n_forces
    n, n_x = n_a + n_f, len(matrices.D)
    size = n + n_x
    H = np.zeros((size, size))
    H[:n_a, :n_a] = matrices.A.T @ matrices.A
    H[n_a:n, n_a:n] = stack.force_weight * np.eye(n_f)
    H[n:, n:] = np.diag(1.0 / stack.slack)
    g = np.zeros(size)
    g[:n_a] = -matrices.A.T @ b[stack.task_rows]
    E = np.zeros((matrices.E_a.shape[0], size))
    E[:, :n_a] = matrices.E_a
    E[:N_DYNAMICS, n_a:n] = matrices.E_f
    C = np.zeros((len(stack.contacts.l) + 2 * n_x, size))
    C[: len(stack.contacts.l), n_a:n] = stack.contacts.C
    limited = np.hstack([matrices.D, np.eye(n_x)])
    C[len(stack.contacts.l) :] = np.vstack([limited, -limited])
    l = np.concatenate([stack.contacts.l, b[stack.layout.n_rows :]])  # noqa: E741
    return QuadraticProgram(H=H, g=g, C=C, l=l, E=E, e=b[stack.equality_rows])


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    # Its transpose, the same, is in the order of LAPACK.
    factor, info = dpotrf(matrix.T, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("not positive definite")
    lower: np.ndarray = factor
    return lower
