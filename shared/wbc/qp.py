"""Strictly convex quadratic programs and the solvers behind one protocol.

    minimise ½ xᵀ H x + gᵀ x   subject to   E x = e,  C x ≥ l

The active set that comes back is always linearly independent together with E: it is factorised
next. `daqp` is a dual active-set method and gives such a set by construction; `proxsuite` is an
augmented-Lagrangian method whose positive multipliers are reduced by a rank-revealing step.
Which is the default, and why, is in `docs/decisions/0002-qp-back-end.md`.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import daqp
import numpy as np
from proxsuite import proxqp

from shared.errors import ConfigError


class QpStatus(enum.Enum):
    """The outcome of a solve."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration_limit"
    NOT_FINITE = "not_finite"
    FAILED = "failed"


@dataclass(frozen=True)
class QuadraticProgram:
    """One problem. H (n, n) symmetric positive definite, E (m_e, n), C (m, n)."""

    H: np.ndarray
    g: np.ndarray
    C: np.ndarray
    l: np.ndarray  # noqa: E741  (the paper's letter)
    E: np.ndarray | None = None
    e: np.ndarray | None = None

    def is_finite(self) -> bool:
        """Return whether all numbers are finite: none is NaN or infinite."""
        arrays = (self.H, self.g, self.C, self.l, self.E, self.e)
        return all(array is None or np.isfinite(array).all() for array in arrays)


@dataclass(frozen=True)
class QpSolution:
    """Result of one solve. `active` holds row indices of C, sorted; `x` is (n,) or empty."""

    status: QpStatus
    x: np.ndarray = field(default_factory=lambda: np.empty(0))
    active: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    iterations: int = 0


class QpSolver(Protocol):
    """A back end. Never raises on a bad problem: the status names the reason."""

    name: str

    def solve(
        self, problem: QuadraticProgram, *, warm_active: np.ndarray | None = None
    ) -> QpSolution:
        """Solve, starting from the active set of an earlier similar problem if one is given."""
        ...


class DaqpSolver:
    """Dual active-set method (Arnström, Bemporad & Axehill 2022), package `daqp`."""

    name = "daqp"

    _INEQUALITY, _ACTIVE, _EQUALITY = 0, 1, 5
    _STATUS: ClassVar = {
        1: QpStatus.SOLVED,
        -1: QpStatus.INFEASIBLE,
        -2: QpStatus.ITERATION_LIMIT,
        -4: QpStatus.ITERATION_LIMIT,
    }

    def __init__(self) -> None:
        self._models: dict[tuple[int, int, int], daqp.Model] = {}

    def solve(
        self, problem: QuadraticProgram, *, warm_active: np.ndarray | None = None
    ) -> QpSolution:
        if not problem.is_finite():
            return QpSolution(QpStatus.NOT_FINITE)
        m = problem.C.shape[0]
        sense = np.zeros(m, dtype=np.int32)
        if warm_active is not None:
            sense[warm_active] = self._ACTIVE
        rows, lower = problem.C, problem.l
        upper = np.full(m, 1e30)
        if problem.E is not None and problem.e is not None:
            rows = np.vstack([problem.E, rows])
            lower = np.concatenate([problem.e, lower])
            upper = np.concatenate([problem.e, upper])
            equalities = np.full(len(problem.e), self._EQUALITY, dtype=np.int32)
            sense = np.concatenate([equalities, sense])
        data = (problem.H, problem.g, np.ascontiguousarray(rows), upper, lower, sense)
        shape = (len(problem.g), len(rows) - m, m)
        # The workspace is kept for the next problem of its shape only if this solve succeeds. A
        # problem without rows cannot be updated.
        model = self._models.pop(shape, None)
        if model is None:
            model = daqp.Model()
            flag, _ = model.setup(*data)
        else:
            flag = model.update(*data)
        if flag < 0:
            return QpSolution(self._STATUS.get(flag, QpStatus.FAILED))
        x, _, flag, info = model.solve()
        status = self._STATUS.get(flag, QpStatus.FAILED)
        if status is not QpStatus.SOLVED:
            return QpSolution(status, iterations=info["iterations"])
        if len(rows):
            self._models[shape] = model
        # A multiplier is non-zero exactly for the rows of the final active set.
        multipliers = np.asarray(info["lam"])[-m:] if m else np.empty(0)
        return QpSolution(
            status=status,
            x=np.asarray(x),
            active=np.flatnonzero(multipliers),
            iterations=info["iterations"],
        )


class ProxsuiteSolver:
    """Proximal augmented-Lagrangian method (Bambade et al. 2022), package `proxsuite`, dense."""

    name = "proxsuite"

    _ACCURACY = 1e-9
    _MAX_ITERATIONS, _MAX_INNER_ITERATIONS = 500, 100
    _STATUS: ClassVar = {
        proxqp.QPSolverOutput.PROXQP_SOLVED: QpStatus.SOLVED,
        proxqp.QPSolverOutput.PROXQP_PRIMAL_INFEASIBLE: QpStatus.INFEASIBLE,
        proxqp.QPSolverOutput.PROXQP_DUAL_INFEASIBLE: QpStatus.FAILED,
        proxqp.QPSolverOutput.PROXQP_MAX_ITER_REACHED: QpStatus.ITERATION_LIMIT,
    }

    def __init__(self) -> None:
        self._workspaces: dict[tuple[int, int, int], proxqp.dense.QP] = {}

    def solve(
        self, problem: QuadraticProgram, *, warm_active: np.ndarray | None = None
    ) -> QpSolution:
        if not problem.is_finite():
            return QpSolution(QpStatus.NOT_FINITE)
        n, m = problem.H.shape[0], problem.C.shape[0]
        m_e = 0 if problem.E is None else problem.E.shape[0]
        upper = np.full(m, 1e30)
        data = (problem.H, problem.g, problem.E, problem.e, problem.C, problem.l, upper)
        workspace = self._workspace(n, m_e, m)
        before = workspace.results.info.status
        if before == proxqp.QPSolverOutput.PROXQP_NOT_RUN:
            workspace.init(*data)
        else:
            workspace.update(*data)
        # Warm means the workspace's own previous iterate, which holds more than an active set.
        # Without a previous iterate `proxsuite` would read memory that is not its own.
        workspace.settings.initial_guess = (
            proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            if warm_active is not None and before == proxqp.QPSolverOutput.PROXQP_SOLVED
            else proxqp.InitialGuess.NO_INITIAL_GUESS
        )
        workspace.solve()
        results = workspace.results
        status = self._STATUS.get(results.info.status, QpStatus.FAILED)
        if status is not QpStatus.SOLVED:
            return QpSolution(status, iterations=results.info.iter)
        multipliers = np.abs(results.z)
        candidates = np.flatnonzero(multipliers > 1e-8 * max(1.0, multipliers.max(initial=0.0)))
        candidates = candidates[np.argsort(-multipliers[candidates], kind="stable")]
        return QpSolution(
            status=status,
            x=np.array(results.x),
            active=independent_rows(problem, candidates),
            iterations=results.info.iter,
        )

    def _workspace(self, n: int, m_e: int, m: int) -> proxqp.dense.QP:
        """Return the workspace of an earlier problem of these sizes, or a new one."""
        workspace = self._workspaces.get((n, m_e, m))
        if workspace is None:
            workspace = proxqp.dense.QP(n, m_e, m)
            workspace.settings.eps_abs = self._ACCURACY
            workspace.settings.eps_rel = 0.0
            workspace.settings.check_duality_gap = False
            # The defaults allow minutes on an infeasible problem.
            workspace.settings.max_iter = self._MAX_ITERATIONS
            workspace.settings.max_iter_in = self._MAX_INNER_ITERATIONS
            self._workspaces[n, m_e, m] = workspace
        return workspace


def independent_rows(problem: QuadraticProgram, candidates: np.ndarray) -> np.ndarray:
    """Largest subset of candidate rows of C that are independent of each other and of E, sorted.

    The subset spans the same space, so it fixes the same solution. In a degenerate corner, for
    example at a point that carries no force, more rows are tight than there are unknowns.
    """
    if candidates.size == 0:
        return candidates
    rows = problem.C[candidates]
    if problem.E is not None and problem.E.shape[0]:
        _, _, basis = np.linalg.svd(problem.E)
        rows = rows @ basis[problem.E.shape[0] :].T
    from scipy.linalg import qr  # not loaded by a robot until it is needed

    _, triangular, order = qr(rows.T, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(triangular))
    rank = int(np.sum(diagonal > 1e-9 * diagonal[0]))
    return np.sort(candidates[order[:rank]])


def make_solver(name: str) -> QpSolver:
    """Solver by its name in the configuration."""
    if name == DaqpSolver.name:
        return DaqpSolver()
    if name == ProxsuiteSolver.name:
        return ProxsuiteSolver()
    raise ConfigError(
        f"solver: expected {DaqpSolver.name!r} or {ProxsuiteSolver.name!r}, got {name!r}"
    )
