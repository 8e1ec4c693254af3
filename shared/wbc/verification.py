"""Tests of an answer against the robot's own matrices, by a few random vectors (Freivalds 1977).

**Of a factorisation.** With K = [H −Eᵀ; E 0] and X = [P Q; −Qᵀ T], K X = I holds for the blocks of
one posture and for no others. The test is K (X x) = x: products of matrices with vectors, and no
factorisation.

**Of a projector with open rows.** It has no choice of the edge but the limits that it leaves open.
Let W be the rows of these limits and of the forces. A† b is the optimum under the equalities alone,
`push` Lᵀ = P Wᵀ, and L Lᵀ = W P Wᵀ + 1/ω. The test computes A† b and P Wᵀ x for random b and x by
the equations of `shared/wbc/least_norm.py`: one factorisation of S = B Bᵀ, at most 24 × 24.

The process that makes the answer must not know the vectors.
"""

from __future__ import annotations

import numpy as np

from shared.wbc.answer import Factorisation, Projector
from shared.wbc.stack import N_DYNAMICS, Stack, StackMatrices

# Vectors per test: an error twice the tolerance passes one of them with probability 0.4.
_N_VECTORS = 8
# The tolerance, as a part of the ratio of the largest task weight to the smallest, by which H
# amplifies the rounding of P to single precision. Measured up to 1 rad from standing: a sixteenth
# of it.
_ROUNDING = 1e-5
_LEAST, _MOST = 1e-3, 0.3
# The tolerance of the response to a vector of unit size. Measured in single precision up to 1 rad
# from standing: 6e-7.
_RESPONSE = 1e-5


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


class OpenRowsTest:
    """The test of projectors with open rows, for one contact mode."""

    def __init__(self, stack: Stack, *, rng: np.random.Generator) -> None:
        self._stack = stack
        self._rng = rng

    def passes(self, matrices: StackMatrices, projector: Projector) -> bool:
        """Return whether A† and the pushes are those of `matrices`, for the limits left open."""
        stack, form, opened = self._stack, self._stack.least_norm_form, projector.open
        assert opened is not None
        problem, n_a = stack.least_norm(matrices), stack.layout.n_accelerations
        k, n_x, n_e = len(opened.limits), len(problem.D), stack.equality_rows.stop
        B = np.ascontiguousarray(problem.rows[:, form.z])
        quantities = opened.limits % n_x
        W = problem.limit_rows(form, quantities)[:, form.z]
        W[opened.limits >= n_x] *= -1.0
        slack = stack.slack[quantities]
        # Rows of E and of W count as having unit length. A force counts as √ω_f f.
        reach = np.sqrt(np.einsum("ij,ij->i", W, W) + slack)[:, None]
        lengths = np.sqrt(np.einsum("ij,ij->i", B[:n_e], B[:n_e]))[:, None]
        random = self._rng.standard_normal
        x, x_f = random((k, _N_VECTORS)) / reach, random((stack.contacts.n_forces, _N_VECTORS))
        b = random((stack.layout.n_rows, _N_VECTORS))
        b[:n_e] *= lengths
        pulled = W.T @ x
        pulled[form.f] += x_f
        asked = np.concatenate([problem.rows[:, form.b] @ b, -(B @ pulled)], axis=1)
        try:
            z = B.T @ np.linalg.solve(B @ B.T, asked)
        except np.linalg.LinAlgError:
            return False
        z[:, _N_VECTORS:] += pulled
        moved = W @ z[:, _N_VECTORS:] + slack[:, None] * x
        # s₁ + ρ₁, and √ω_f f.
        z[:n_a, :_N_VECTORS] += b[n_e : n_e + n_a]
        expected = z[: form.f.stop]
        with np.errstate(over="ignore", invalid="ignore"):
            u = opened.push[n_a:].T @ (x_f / form.force_scale)
            u[:k] += opened.factor.T @ x
            y = np.concatenate([projector.A_dagger @ b, opened.push @ u], axis=1)
            got = np.concatenate([matrices.A[:n_a] @ y[:n_a], y[n_a:] / form.force_scale])
            errors = (
                np.abs(got - expected).max() / np.abs(expected).max(),
                np.abs((opened.factor @ u[:k] - moved) / reach).max(initial=0.0),
            )
        # Each number is compared, because a maximum may skip a NaN.
        return all(error <= _RESPONSE for error in errors)
