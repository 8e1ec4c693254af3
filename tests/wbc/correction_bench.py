"""The rows of a contact mode and steps of a corrector by hand, for tests of corrections."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Corrector, Iterate
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.projector import full_problem
from shared.wbc.qp import QpStatus, make_solver

# Against the full QP: 3e-10 measured where the factorisation is fresh, 2e-9 a few metres away,
# where b is larger.
TOLERANCE = 1e-8
# How far each joint is from where the factorisation was computed [rad].
DISTANCE = 0.05

MODES = list(ContactMode)
DOUBLE, LEFT, RIGHT = MODES
LEVELS = ["b", "b_adjoint", "c"]
EXACT_CONSTRAINTS = ["b", "b_adjoint"]

TURNS = {
    "yaw 180°": pin.utils.rotate("z", np.pi),
    "roll 180°": pin.utils.rotate("x", np.pi),
    "somehow": pin.utils.rpyToMatrix(0.7, -1.1, 2.3),
}


class Bench:
    """The rows of one contact mode at any state, and steps of a corrector by hand."""

    def __init__(self, stack, model, reference):
        self.stack, self.model, self.reference = stack, model, reference

    def matrices(self, q):
        return self.stack.matrices(self.model.jacobians(q))

    def factorise(self, q, *, damping=0.0):
        return factorise_kkt(self.stack, self.matrices(q), q[7:], damping=damping)

    def problem(self, state, *, matrices_at=None):
        """The full QP at a state, optionally with the matrices of another configuration."""
        b = self.stack.right_hand_side(self.model.kinematics(*state), self.reference)
        q = state.q if matrices_at is None else matrices_at
        return full_problem(self.stack, self.matrices(q), b)

    def optimum(self, state, **how):
        solution = make_solver("daqp").solve(self.problem(state, **how))
        assert solution.status is QpStatus.SOLVED
        return solution

    def linearised(self, state, y):
        """Kinematics and the residual b − M y, from the passes that the robot makes."""
        a, f = np.split(y, [self.model.nv])
        now = self.model.kinematics(*state, a, self.stack.contacts.wrenches(f))
        return now, self.stack.right_hand_side(now, self.reference)

    def step(self, corrector, iterate, state):
        now, residual = self.linearised(state, iterate.y)
        return corrector.step(iterate, residual, self.model, now)

    def iterates(self, factorisation, state, *, level, steps):
        """The iterates after each step from zero."""
        corrector = Corrector(self.stack, factorisation, level=level)
        iterate = Iterate.zero(self.stack)
        for _ in range(steps):
            iterate, _ = self.step(corrector, iterate, state)
            yield iterate

    def converged(self, factorisation, state, *, level, steps):
        *_, last = self.iterates(factorisation, state, level=level, steps=steps)
        return last


def relative(difference, y):
    return np.abs(difference).max() / np.abs(y).max()


def outside_span(vector, rows):
    """Part of a vector that no combination of the rows gives, relative to the vector."""
    multipliers = np.linalg.lstsq(rows.T, vector, rcond=None)[0]
    return np.abs(vector - rows.T @ multipliers).max() / np.abs(vector).max()


def moved(q, rotation, translation):
    """The same posture with the whole robot carried somewhere else in the world."""
    world_from_base = pin.XYZQUATToSE3(q[:7])
    placed = pin.SE3(rotation, np.asarray(translation, dtype=float)) * world_from_base
    return np.concatenate([pin.SE3ToXYZQUAT(placed), q[7:]])
