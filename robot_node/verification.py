"""Checks of an answer's content: an edge may be silent, but it must not make a robot fall.

The robot can verify LC's factorisation completely: it is the inverse of the robot's own KKT matrix,
at a posture near the one that the robot sent. LA's projector contains a choice of the edge, the
active set. The robot can verify only that its solution obeys the robot's dynamics and contacts. A
projector with open rows leaves the choice to the robot, which can verify it completely, too.
"""

from __future__ import annotations

import math

import numpy as np

from shared.config.settings import RunConfig
from shared.errors import MessageRefused
from shared.robots import GRAVITY, Robot
from shared.wbc.answer import Factorisation, Projector
from shared.wbc.assisted import apply_projector
from shared.wbc.contacts import ContactMode
from shared.wbc.finite import all_finite
from shared.wbc.model import Jacobians, WholeBodyModel
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack
from shared.wbc.verification import InverseTest, OpenRowsTest

# Distance of a factorised posture from the one that the robot sent [rad]: root mean square, and of
# one joint. The edge looks ahead by up to 0.05 rad, a third of which may be in one joint. Noise
# comes on top, in standard deviations.
_DISTANCE, _DISTANCE_NOISE = 0.07, 2.0
_JOINT_DISTANCE, _JOINT_NOISE = 0.3, 6.0

# Force and moment [of the weight, and of the weight times the height of the CoM] that the base
# would lack to follow a projector's solution when it is first used. Beyond these the projector is
# tested at its own state. With answers 120 ms old Romeo lacks up to 0.15 and 0.11 in a push; with
# no forces at all, 1.
_FORCE, _MOMENT = 0.2, 0.2
# The tolerance of an equality at the projector's own state, as a part of the largest equality row.
# Measured in single precision: 1e-5.
_EXACT = 1e-2


class FactorisationVerifier:
    """Compares factorisations with the robot's own model.

    `rng` draws the vectors of the test. Its seed must be a secret.
    """

    def __init__(
        self,
        robot: Robot,
        stacks: dict[ContactMode, Stack],
        config: RunConfig,
        rng: np.random.Generator,
    ) -> None:
        # A separate workspace, because an answer may come between the two phases of a tick.
        self._model = WholeBodyModel(robot)
        self._stacks = stacks
        self._tests = {
            mode: InverseTest(stack, damping=config.correction.damping, rng=rng)
            for mode, stack in stacks.items()
        }
        noise = config.sensors.joint_position_noise
        # The study of wrong postures has the edge move every joint by this much.
        wrong = config.correction.posture_error
        self._distance = _DISTANCE + _DISTANCE_NOISE * noise + wrong
        self._joint_distance = _JOINT_DISTANCE + _JOINT_NOISE * noise + wrong

    def check(self, factorisation: Factorisation, *, measured: np.ndarray) -> None:
        """Raise `MessageRefused` if these are not the blocks at a posture near `measured`.

        `measured` (nv − 6,) are the joint positions of the state that the answer is for [rad].
        """
        posture = factorisation.posture
        moved = posture - measured
        distance = math.sqrt(moved @ moved / len(moved))
        if not (distance <= self._distance and np.abs(moved).max() <= self._joint_distance):
            raise MessageRefused("posture", f"{distance:.2f} rad from the state that it is for")
        mode = factorisation.mode
        matrices = self._stacks[mode].matrices(self._jacobians(posture))
        if not self._tests[mode].passes(matrices, factorisation):
            raise MessageRefused("not_inverse", f"{mode.name}: not the robot's own KKT matrix")

    def limit_rows(self, factorisation: Factorisation) -> np.ndarray:
        """The rows D of the robot's limits at the posture of a factorisation, (n_x, n)."""
        stack = self._stacks[factorisation.mode]
        return stack.limit_rows(self._jacobians(factorisation.posture))

    def _jacobians(self, posture: np.ndarray) -> Jacobians:
        q = self._model.robot.q_standing.copy()
        q[7:] = posture
        return self._model.jacobians(q)


class ProjectorVerifier:
    """Compares projectors with the robot's own dynamics and contacts.

    The solution of a projector at its own state obeys them exactly, for any b. On the next ticks it
    obeys them nearly as well. The robot knows in every tick the force that the base lacks. If this
    force is large at the first use, the projector is tested at its own state. So it is when the
    robot first needs the pushes of its open rows. `rng` is as for `FactorisationVerifier`.
    """

    def __init__(
        self,
        model: WholeBodyModel,
        stacks: dict[ContactMode, Stack],
        reference: Reference,
        rng: np.random.Generator,
    ) -> None:
        self._model = model
        self._stacks = stacks
        self._reference = reference
        self._open_tests = {mode: OpenRowsTest(stack, rng=rng) for mode, stack in stacks.items()}
        weight = GRAVITY * model.robot.mass
        self._force = (_FORCE * weight) ** 2
        self._moment = (_MOMENT * weight * float(reference.com[2])) ** 2

    def is_plausible(self, force: np.ndarray) -> bool:
        """Return whether the base lacks little of `force` (nv,), M a + h − J_cᵀ f."""
        f, m = force[:3], force[3:6]
        return bool(f.dot(f) <= self._force) and bool(m.dot(m) <= self._moment)

    def is_exact(self, projector: Projector, q: np.ndarray, v: np.ndarray) -> bool:
        """Return whether the projector's solution obeys all equalities at its own state (q, v).

        With open rows the whole projector must be that of the state. Overwrites the model.
        """
        stack, model = self._stacks[projector.mode], self._model
        if projector.open is not None:
            matrices = stack.matrices(model.jacobians(q))
            return self._open_tests[projector.mode].passes(matrices, projector)
        b = stack.right_hand_side(model.kinematics(q, v), self._reference)
        with np.errstate(over="ignore", invalid="ignore"):
            y = apply_projector(stack, projector, b, model=model, q=q, v=v).y
            if not all_finite(y):
                return False
            left = stack.right_hand_side(
                stack.kinematics_at(y, model=model, q=q, v=v), self._reference
            )
            wrong = np.abs(left[stack.equality_rows]).max()
        return bool(wrong <= _EXACT * np.abs(b[stack.equality_rows]).max())
