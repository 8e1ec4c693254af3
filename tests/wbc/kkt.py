"""Optimality of a point, from the definition: the judge of every solver and of every projector."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shared.wbc.qp import QuadraticProgram


class Kkt(NamedTuple):
    """How far a point is from the optimum of a strictly convex QP; all entries are 0 there.

    `stationarity`: part of the gradient outside the span of the active rows, relative to the terms
    it is a sum of. `negative_multiplier`: size of the most negative multiplier, relative likewise.
    `equality`, `violation`, `slack`: |E x − e|, depth outside C x ≥ l, and distance of an active
    row from its bound.
    """

    stationarity: float
    negative_multiplier: float
    equality: float
    violation: float
    slack: float


def kkt(problem: QuadraticProgram, x: np.ndarray, active: np.ndarray) -> Kkt:
    """Judge the point `x` with the active rows `active` of C."""
    n = len(x)
    E = np.zeros((0, n)) if problem.E is None else problem.E
    e = np.zeros(0) if problem.e is None else problem.e
    gradient = problem.H @ x + problem.g
    rows = np.vstack([E, problem.C[active]])
    multipliers = np.linalg.lstsq(rows.T, gradient, rcond=None)[0]
    remainder = gradient - rows.T @ multipliers
    scale = max(1.0, np.abs(problem.H @ x).max(), np.abs(problem.g).max())
    margins = problem.C @ x - problem.l
    return Kkt(
        stationarity=float(np.abs(remainder).max() / scale),
        negative_multiplier=float(-multipliers[len(e) :].min(initial=0.0) / scale),
        equality=float(np.abs(E @ x - e).max(initial=0.0)),
        violation=float(-margins.min(initial=0.0)),
        slack=float(np.abs(margins[active]).max(initial=0.0)),
    )


def solution_of_active_set(problem: QuadraticProgram, active: np.ndarray) -> np.ndarray:
    """The minimiser with E and the active rows of C at equality, from the whole KKT matrix."""
    n = problem.H.shape[0]
    E = np.zeros((0, n)) if problem.E is None else problem.E
    e = np.zeros(0) if problem.e is None else problem.e
    rows = np.vstack([E, problem.C[active]])
    m = len(rows)
    matrix = np.block([[problem.H, rows.T], [rows, np.zeros((m, m))]])
    return np.linalg.solve(matrix, np.concatenate([-problem.g, e, problem.l[active]]))[:n]


def are_independent(problem: QuadraticProgram, active: np.ndarray) -> bool:
    """Whether the active rows are linearly independent of each other and of E."""
    n = problem.H.shape[0]
    E = np.zeros((0, n)) if problem.E is None else problem.E
    rows = np.vstack([E, problem.C[active]])
    return not len(rows) or int(np.linalg.matrix_rank(rows)) == len(rows)
