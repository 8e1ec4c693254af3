"""Factorisation of the KKT matrix of the whole-body QP, for corrections by the robot."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from shared.wbc.answer import Factorisation
from shared.wbc.stack import N_DYNAMICS, Stack, StackMatrices


def factorise_kkt(
    stack: Stack, matrices: StackMatrices, posture: np.ndarray, *, damping: float = 0.0
) -> Factorisation:
    """The blocks at one configuration. `numpy.linalg.LinAlgError` if the rows are dependent.

    `damping` is added to the diagonal of AᵀA, which makes H larger than the true one, for level
    `c`.
    """
    n_a, n_f = stack.layout.n_accelerations, stack.layout.n_forces
    n_e = matrices.E_a.shape[0]
    H_a = matrices.A.T @ matrices.A
    H_a.flat[:: n_a + 1] += damping
    P_0 = np.zeros((n_a + n_f, n_a + n_f))
    P_0[:n_a, :n_a] = _spd_inverse(H_a)
    P_0.flat[n_a * (n_a + n_f + 1) :: n_a + n_f + 1] = 1.0 / stack.force_weight
    E = np.zeros((n_e, n_a + n_f))
    E[:, :n_a] = matrices.E_a
    E[:N_DYNAMICS, n_a:] = matrices.E_f
    E_P = E @ P_0
    T = _spd_inverse(E_P @ E.T)
    Q = E_P.T @ T
    return Factorisation(stack.mode, P_0 - Q @ E_P, Q, T, matrices.A, posture)


def _spd_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix by its Cholesky factor."""
    factor, info = dpotrf(matrix, lower=1, clean=1)
    if info == 0:
        inverse, info = dpotri(factor, lower=1, overwrite_c=1)
    if info != 0 or not math.isfinite(inverse[-1, -1]):
        raise np.linalg.LinAlgError("not positive definite")
    inverse.reshape(-1, order="F")[:: matrix.shape[0] + 1] *= 0.5
    whole: np.ndarray = inverse + inverse.T
    return whole
