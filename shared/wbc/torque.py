"""Joint torques from the solution y = (a, f), Eq. (1a), with the dynamics of the present state.

A stale projector gives a stale trade-off between tasks, never stale dynamics: τ is recovered with
the M, h and J_c of the newest measurement.
"""

from __future__ import annotations

import numpy as np

from shared.wbc.contacts import ContactGeometry
from shared.wbc.model import Live, WholeBodyModel


def recover_force(
    model: WholeBodyModel, contacts: ContactGeometry, q: np.ndarray, v: np.ndarray, y: np.ndarray
) -> Live:
    """Generalised force M a + h − J_cᵀ f, shape (nv,), from y = (a, f) at (q, v).

    The first six entries, those of the base, are the residual of the dynamics at y [N, N m].
    """
    a, f = y[: model.nv], y[model.nv :]
    return model.inverse_dynamics(q, v, a, contacts.wrenches(f))


def recover_torque(
    model: WholeBodyModel, contacts: ContactGeometry, q: np.ndarray, v: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Joint torques τ = S (M a + h − J_cᵀ f), shape (nv − 6,) [N m], from y = (a, f) at (q, v)."""
    return recover_force(model, contacts, q, v, y)[6:].copy()
