"""The builder of the QP's rows, Eqs. (2), (5) and (6). Both ends of the link use it.

The robot asks it for `right_hand_side` (b: cheap, every millisecond); the edge also for `matrices`
(A: Jacobians). The rows of b that carry feedback are named in one `RowLayout`:

    dynamics 6 | contacts 6 per loaded foot | com 3 | base_orientation 3 | posture |
    angular_momentum 3 | cop 2 | swing_foot 6 (single support) | bounds 1

Angular momentum and CoP have rows only with a weight. Force regularisation targets zero and needs
no row. The bounds of active inequality rows are constant, so `bounds` is a single entry, always 1:
one column of a projector holds their effect. The entries of the robot's own limits follow the rows
of the layout, see `limits`.
"""

from __future__ import annotations

import functools
import hashlib
import math
from dataclasses import dataclass

import numpy as np

from shared.config.control_settings import WbcConfig
from shared.robots import Foot, Robot
from shared.wbc.contacts import (
    FORCES_PER_FOOT,
    ContactGeometry,
    ContactMode,
    contact_geometry,
)
from shared.wbc.least_norm import LeastNorm, LeastNormForm
from shared.wbc.limits import Limits
from shared.wbc.model import Jacobians, Kinematics, RowMultipliers, WholeBodyModel
from shared.wbc.reference import Reference
from shared.wbc.tasks import (
    AngularMomentumTask,
    BaseOrientationTask,
    ComTask,
    CopTask,
    PostureTask,
    SwingFootTask,
    Task,
)

N_DYNAMICS = 6
ROWS_PER_CONTACT = 6


@dataclass(frozen=True)
class RowLayout:
    """Names and sizes of the rows of b, and of the unknowns y = (a, f), for one contact mode."""

    mode: ContactMode
    n_accelerations: int
    n_forces: int
    blocks: tuple[tuple[str, int], ...]

    @functools.cached_property
    def n_rows(self) -> int:
        return sum(size for _, size in self.blocks)

    @property
    def n_unknowns(self) -> int:
        return self.n_accelerations + self.n_forces

    def slice(self, name: str) -> slice:
        """Rows of one block."""
        start = 0
        for block, size in self.blocks:
            if block == name:
                return slice(start, start + size)
            start += size
        raise KeyError(name)

    @property
    def digest(self) -> bytes:
        """Eight bytes that both ends compare before they exchange a matrix."""
        return hashlib.sha256(repr(self).encode()).digest()[:8]


@dataclass(slots=True)
class StackMatrices:
    """The matrices of the QP at one configuration; friction rows live in `ContactGeometry`.

    Equalities `E_a a + E_f f = e`, E_a (6 + 6 n_c, nv), E_f (6, n_f) for the dynamics rows only
    (contact rows do not touch f); tasks `A a ≈ s`, A (n_t, nv), already √ω-weighted; limited
    quantities `D y + x₀`, D (n_x, n), (0, n) without limits.
    """

    E_a: np.ndarray
    E_f: np.ndarray
    A: np.ndarray
    D: np.ndarray


class Stack:
    """Rows of the whole-body QP of one robot in one contact mode."""

    def __init__(
        self, robot: Robot, config: WbcConfig, mode: ContactMode, limits: Limits | None = None
    ) -> None:
        nv = robot.model.nv
        gains, weights = config.gains, config.weights
        self.mode = mode
        self.limits = limits
        self.slack = np.empty(0) if limits is None else limits.slack
        self.contacts: ContactGeometry = contact_geometry(
            robot,
            mode,
            friction=config.friction,
            min_normal_force=config.min_normal_force,
        )
        self.force_weight = weights.force
        self.contact_damping = gains.contact_damping
        self.tasks: tuple[Task, ...] = (
            ComTask(weight=weights.com, kp=gains.com),
            BaseOrientationTask(weight=weights.base_orientation, kp=gains.base_orientation, nv=nv),
            PostureTask(weight=weights.posture, kp=gains.posture, nv=nv),
            *(
                [AngularMomentumTask(weight=weights.angular_momentum, kp=gains.angular_momentum)]
                if weights.angular_momentum
                else []
            ),
            *(
                [CopTask(weight=weights.cop, mass=robot.mass, foot=self.support_foot)]
                if weights.cop
                else []
            ),
            *(
                SwingFootTask(weight=weights.swing_foot, kp=gains.swing_foot, foot=foot)
                for foot in Foot
                if foot not in mode.feet
            ),
        )
        self.layout = RowLayout(
            mode=mode,
            n_accelerations=nv,
            n_forces=self.contacts.n_forces,
            blocks=(
                ("dynamics", N_DYNAMICS),
                ("contacts", ROWS_PER_CONTACT * len(mode.feet)),
                *((task.name, task.size) for task in self.tasks),
                ("bounds", 1),
            ),
        )
        self._weighted_tasks = [(task, math.sqrt(task.weight), task.size) for task in self.tasks]
        self._n_rows = self.layout.n_rows
        self._n_b = self._n_rows + (0 if limits is None else limits.n_entries)
        self._n_equalities = N_DYNAMICS + ROWS_PER_CONTACT * len(mode.feet)
        task_rows = sum(task.size for task in self.tasks)
        varying = [np.full(task.size, not task.constant) for task in self.tasks]
        # The rows of A that depend on the configuration. The others are constant.
        self.varying_task_rows = np.flatnonzero(np.concatenate(varying))
        self.constant_task_rows = self._constant_task_rows()
        self.equality_rows = slice(0, self._n_equalities)
        self.task_rows = slice(self._n_equalities, self._n_equalities + task_rows)
        contacts = range(N_DYNAMICS, self._n_equalities, ROWS_PER_CONTACT)
        self._contact_rows = [
            (foot, slice(row, row + ROWS_PER_CONTACT))
            for foot, row in zip(mode.feet, contacts, strict=True)
        ]
        self._rows_of_tasks = [(task, self.layout.slice(task.name)) for task in self.tasks]
        self.least_norm_form = LeastNormForm(
            self.contacts,
            n_equalities=self._n_equalities,
            n_accelerations=nv,
            task_weights=np.repeat([t.weight for t in self.tasks], [t.size for t in self.tasks]),
            force_weight=weights.force,
        )
        self._varying_tasks = [
            (task, sqrt_weight, self._rows_of(task))
            for task, sqrt_weight, _ in self._weighted_tasks
            if not task.constant
        ]
        self._minus_wrench_maps = [-self.contacts.wrench_map[foot] for foot in mode.feet]

    def _constant_task_rows(self) -> np.ndarray:
        """A with zeros where it depends on the configuration, (n_t, nv)."""
        nv = self.layout.n_accelerations
        anywhere = Jacobians(np.zeros((6, nv)), np.zeros((nv - 6, nv)), {}, np.zeros((3, nv)))
        return np.concatenate(
            [
                sqrt_weight * task.jacobian(anywhere) if task.constant else np.zeros((size, nv))
                for task, sqrt_weight, size in self._weighted_tasks
            ]
        )

    def _rows_of(self, task: Task) -> slice:
        """Rows of A."""
        rows = self.layout.slice(task.name)
        return slice(rows.start - self._n_equalities, rows.stop - self._n_equalities)

    def kinematics_at(
        self, y: np.ndarray, *, model: WholeBodyModel, q: np.ndarray, v: np.ndarray
    ) -> Kinematics:
        """The kinematics at (q, v) under a solution y (n,): its accelerations and forces."""
        n_a = self.layout.n_accelerations
        return model.kinematics(q, v, y[:n_a], self.contacts.wrenches(y[n_a:]))

    def right_hand_side(
        self, kinematics: Kinematics, reference: Reference, *, with_limits: bool = True
    ) -> np.ndarray:
        """b of Eq. (6), shape (layout.n_rows,), longer with limits.

        Dynamics rows −h_u [N, N m]; contact rows −J̇ v − kd J v [m/s², rad/s²]; task rows
        √ω (s̈* − J̇ v); a 1. With `kinematics_at` a solution y it is the residual of every row at y
        instead: e − E y, √ω (s̈* − J̇ v − J a). With limits, their entries follow: how far each
        quantity is beyond its lower, then beyond its upper bound, see `Limits`. `with_limits=False`
        leaves them out: they are no part of A† b.
        """
        limits = self.limits if with_limits else None
        b = np.empty(self._n_rows if limits is None else self._n_b)
        np.negative(kinematics.force[:N_DYNAMICS], b[:N_DYNAMICS])
        for foot, rows in self._contact_rows:
            of_contact = b[rows]
            np.multiply(kinematics.sole_velocity[foot], -self.contact_damping, of_contact)
            of_contact -= kinematics.sole_acceleration[foot]
        for task, rows in self._rows_of_tasks:
            task.write_target(b[rows], kinematics, reference)
        b[self._n_rows - 1] = 1.0
        if limits is not None:
            of_limits = limits.misses(kinematics.q, kinematics.v, kinematics.a, kinematics.force)
            b[self._n_rows :] = of_limits
        return b

    def add_task_multipliers(
        self, residual: np.ndarray, multipliers: RowMultipliers, now: Kinematics
    ) -> None:
        """Add Aᵀ r for the weighted task rows r of `residual` (n_rows,), at the kinematics."""
        row = self.task_rows.start
        for task, sqrt_weight, size in self._weighted_tasks:
            task.add_transposed(sqrt_weight * residual[row : row + size], multipliers, now)
            row += size

    def matrices(self, jacobians: Jacobians) -> StackMatrices:
        """E_a, E_f, A of Eq. (5) and D at one configuration."""
        soles = [jacobians.J_sole[foot] for foot in self.mode.feet]
        E_f = np.empty((N_DYNAMICS, self.layout.n_forces))
        for k, (J, minus_G) in enumerate(zip(soles, self._minus_wrench_maps, strict=True)):
            forces = slice(k * FORCES_PER_FOOT, (k + 1) * FORCES_PER_FOOT)
            np.matmul(J[:, :N_DYNAMICS].T, minus_G, out=E_f[:, forces])
        A = self.constant_task_rows.copy()
        for task, sqrt_weight, rows in self._varying_tasks:
            np.multiply(task.jacobian(jacobians), sqrt_weight, out=A[rows])
        E_a = np.concatenate([jacobians.M_unactuated, *soles])
        return StackMatrices(E_a, E_f, A, self.limit_rows(jacobians))

    def least_norm(self, matrices: StackMatrices) -> LeastNorm:
        """The same QP as a search for the shortest vector, friction rows left out."""
        return self.least_norm_form.at(matrices.E_a, matrices.E_f, matrices.A, matrices.D)

    def limit_rows(self, jacobians: Jacobians) -> np.ndarray:
        """D of the limited quantities x = D y + x₀, (n_x, n): torques, then joint accelerations.

        Without limits (0, n).
        """
        n_a, n = self.layout.n_accelerations, self.layout.n_unknowns
        if self.limits is None:
            return np.zeros((0, n))
        n_joints = n_a - N_DYNAMICS
        rows = np.zeros((2 * n_joints, n))
        torques = rows[:n_joints]
        torques[:, :n_a] = jacobians.M_actuated
        for k, (foot, minus_G) in enumerate(
            zip(self.mode.feet, self._minus_wrench_maps, strict=True)
        ):
            forces = slice(n_a + k * FORCES_PER_FOOT, n_a + (k + 1) * FORCES_PER_FOOT)
            torques[:, forces] = jacobians.J_sole[foot][:, N_DYNAMICS:].T @ minus_G
        torques *= self.limits.torque_scale[:, np.newaxis]
        rows[n_joints:, N_DYNAMICS:n_a] = np.eye(n_joints)
        return rows

    @property
    def support_foot(self) -> Foot:
        """The foot whose contact violation is reported, Sec. IV-C: the first loaded one."""
        return self.mode.feet[0]

    def contact_violation(self, velocity: np.ndarray, acceleration: np.ndarray) -> float:
        """‖J_c a + J̇_c v‖ of the support foot without the contact damping term [m/s²].

        It is computed from the velocity and the acceleration of the sole, (6,) each. The damping
        that the contact rows ask for is wanted, so it is not counted as a violation.
        """
        violation = acceleration + self.contact_damping * velocity
        return math.sqrt(violation.dot(violation))


def make_stacks(
    robot: Robot, config: WbcConfig, limits: Limits | None = None
) -> dict[ContactMode, Stack]:
    """The stack of every contact mode."""
    return {mode: Stack(robot, config, mode, limits) for mode in ContactMode}
