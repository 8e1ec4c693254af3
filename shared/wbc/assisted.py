"""LA: the solution of a projector for the b of a tick.

Without limits of the robot it is y = A† b, Eq. (4). With limits the projector has decided on no
inequality row, because a stale decision does harm. It would throw a joint back to a bound that the
joint has left, and an unloading foot would pull. The robot then decides,

    y = A† b + push u,   min ½ ‖u‖²   s.t.   C f ≥ l,   and each limit within its bound.

Forces and limited quantities of A† b are exact: torques and bounds are those of the present state.
`push` is stale. On the projector's own state y is the optimum of the full QP.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from shared.wbc.answer import Openness, Projector
from shared.wbc.model import Live, WholeBodyModel
from shared.wbc.stack import Stack
from shared.wbc.torque import recover_force

_NO_BOUND = 1e30


@dataclass(slots=True)
class Assisted:
    """A solution `y` (n,), its generalised force (nv,), see `recover_force`, and its active set.

    `pushes`: A† b breaks an inequality, so that the pushes decide on the solution.
    """

    y: np.ndarray
    force: Live
    active_set: int
    pushes: bool = False


def apply_projector(
    stack: Stack,
    projector: Projector,
    b: np.ndarray,
    *,
    model: WholeBodyModel,
    q: np.ndarray,
    v: np.ndarray,
) -> Assisted:
    """The solution for b, which is that of (q, v). `stack` is that of the projector's mode.

    Entries of b after the layout's rows, those of limits, are not used.
    """
    y = projector.apply(b)
    force = recover_force(model, stack.contacts, q, v, y)
    limits, opened = stack.limits, projector.open
    if limits is None or opened is None:
        return Assisted(y, force, projector.active_set)
    contacts, a, f = stack.contacts, y[: model.nv], y[model.nv :]
    lacks = contacts.C.dot(f)
    np.subtract(contacts.l, lacks, lacks)
    # `argmax` takes a quarter of the time of `max`.
    within = lacks[lacks.argmax()] <= 0.0
    if within and limits.clearly_hold(opened.limits, q, v, a, force):
        return Assisted(y, force, 0)
    misses = limits.misses(q, v, a, force)[opened.limits]
    if within and misses.max(initial=0.0) <= 0.0:
        return Assisted(y, force, 0)
    decided = _decide(stack, opened, misses, lacks)
    if decided is None:  # the clamp still limits the torque
        return Assisted(y, force, projector.active_set, pushes=True)
    u, active = decided
    y += opened.push.dot(u)
    force = recover_force(model, stack.contacts, q, v, y)
    return Assisted(y, force, stack.mode.active_set(active), pushes=True)


def _decide(
    stack: Stack, opened: Openness, misses: np.ndarray, lacks: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The smallest u (k + n_f,) that obeys limits with these misses (k,) and the friction rows, and
    the active rows of C.

    None if the solver finds none.
    """
    k, n_u = len(misses), opened.push.shape[1]
    rows = np.zeros((k + len(lacks), n_u))
    rows[:k, :k] = opened.factor
    np.matmul(stack.contacts.C, opened.push[stack.layout.n_accelerations :], out=rows[k:])
    lower = np.concatenate([misses, lacks])
    upper, sense = np.full(len(lower), _NO_BOUND), np.zeros(len(lower), dtype=np.int32)
    try:
        u, _, flag, info = daqp.solve(np.eye(n_u), np.zeros(n_u), rows, upper, lower, sense)
    except RuntimeError:  # daqp reports a failure by this error
        return None
    if flag != 1:
        return None
    return np.asarray(u), np.flatnonzero(np.asarray(info["lam"])[k:])
