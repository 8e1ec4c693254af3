"""Test of a factorisation against the KKT matrix that it claims to invert.

With K = [H −Eᵀ; E 0] and X = [P Q; −Qᵀ T], K X = I holds for the blocks of one posture and for no
others. The test is K (X x) = x for a few random x (Freivalds 1977): products of matrices with
vectors, and no factorisation. The process that makes X must not know x.
"""

from __future__ import annotations

import numpy as np

from shared.wbc.answer import Factorisation
from shared.wbc.stack import N_DYNAMICS, Stack, StackMatrices

# Vectors per test: an error twice the tolerance passes one of them with probability 0.4.
_N_VECTORS = 8
# The tolerance, as a part of the ratio of the largest task weight to the smallest, by which H
# amplifies the rounding of P to single precision. Measured up to 1 rad from standing: a sixteenth
# of it.
_ROUNDING = 1e-5
_LEAST, _MOST = 1e-3, 0.3


class InverseTest:
    """The test for one contact mode. `damping` is that of `factorise_kkt`."""

    def __init__(self, stack: Stack, *, damping: float, rng: np.random.Generator) -> None:
        self._stack = stack
        self._damping = damping
        self._rng = rng
        weights = [task.weight for task in stack.tasks]
        self.tolerance = min(max(_ROUNDING * max(weights) / min(weights), _LEAST), _MOST)
        # Forces count as √ω_f f, so that their part of H is the identity.
        self._root = np.ones((stack.layout.n_unknowns, 1))
        self._root[stack.layout.n_accelerations :] = np.sqrt(stack.force_weight)

    def passes(self, matrices: StackMatrices, factorisation: Factorisation) -> bool:
        """Return whether the blocks are those of `matrices`, each within `tolerance` of K X = I."""
        n_a, n = self._stack.layout.n_accelerations, self._stack.layout.n_unknowns
        E_a, E_f, A = matrices.E_a, matrices.E_f, matrices.A
        P, Q, T = factorisation.P, factorisation.Q, factorisation.T
        # Rows of E count as having unit length.
        lengths = np.square(E_a).sum(axis=1)
        lengths[:N_DYNAMICS] += np.square(E_f).sum(axis=1) / self._stack.force_weight
        length = np.sqrt(lengths)[:, None]
        x = self._rng.standard_normal((n + len(length), _N_VECTORS))
        g, e = self._root * x[:n], length * x[n:]
        # Blocks whose products overflow are no inverse.
        with np.errstate(over="ignore", invalid="ignore"):
            wrong_A = np.abs(factorisation.A - A).max() / np.abs(A).max()
            y = P @ g + Q @ e
            nu = T @ e - Q.T @ g
            a, f = y[:n_a], y[n_a:]
            E_y = E_a @ a
            E_y[:N_DYNAMICS] += E_f @ f
            stationary = np.empty_like(y)
            stationary[:n_a] = A.T @ (A @ a) + self._damping * a - E_a.T @ nu
            stationary[n_a:] = self._stack.force_weight * f - E_f.T @ nu[:N_DYNAMICS]
            errors = (
                wrong_A,
                np.abs((stationary - g) / self._root).max(),
                np.abs((E_y - e) / length).max(),
            )
        # Each number is compared, because a maximum may skip a NaN.
        return all(error <= self.tolerance for error in errors)
