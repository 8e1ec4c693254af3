"""The full controller at one state: terms, QP, projector.

The edge runs it, and so does the robot's on-board computer around a contact switch.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from shared.config.settings import RunConfig
from shared.robots import Robot
from shared.wbc.answer import Factorisation, Projector, TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.limits import Limits
from shared.wbc.model import WholeBodyModel
from shared.wbc.projector import WholeBodySolution, solve
from shared.wbc.qp import make_solver
from shared.wbc.reference import Motion, Reference
from shared.wbc.stack import make_stacks

FOR_EVER_NS = 2**62

# The active rows of C, and the active limits.
ActiveSet = tuple[np.ndarray, np.ndarray]


class WholeBodyController:
    """Solves the whole-body QP of one robot and task, in any contact mode.

    `last_active` are the active sets of the last solutions, which are tried first. A caller with
    several robots gives each its own.
    """

    def __init__(self, robot: Robot, config: RunConfig, motion: Motion) -> None:
        self.model = WholeBodyModel(robot)
        self.stacks = make_stacks(robot, config.wbc, Limits.of(robot, config))
        self._motion = motion
        self._solver = make_solver(config.wbc.solver)
        self.last_active: dict[ContactMode, ActiveSet] = {}

    def solve(
        self,
        q: np.ndarray,
        v: np.ndarray,
        *,
        time_ns: int,
        mode: ContactMode,
        com_command: np.ndarray | None = None,
        reference: Reference | None = None,
    ) -> tuple[WholeBodySolution, np.ndarray]:
        """Solution at (q, v) for a contact mode and the reference of `time_ns`; and its b.

        `com_command` is that of the robot's balance law, see `Reference`. A `reference` of the
        robot's own replaces the motion's.
        """
        stack = self.stacks[mode]
        kinematics = self.model.kinematics(q, v)
        if reference is None:
            reference = self._motion.reference(time_ns)
        if com_command is not None:
            reference = dataclasses.replace(reference, com_command=com_command)
        b = stack.right_hand_side(kinematics, reference)
        matrices = stack.matrices(self.model.jacobians(q))
        rows, limits = self.last_active.get(mode, (None, None))
        solution = solve(
            stack,
            matrices,
            b,
            solver=self._solver,
            likely_active=rows,
            likely_limits=limits,
        )
        if solution.held is not None:
            self.last_active[mode] = (solution.held.active, solution.held.limits)
        return solution, b

    def factorise(
        self, q: np.ndarray, modes: tuple[ContactMode, ...], *, damping: float
    ) -> tuple[Factorisation, ...] | None:
        """Factorisations of some contact modes at one configuration; None if one is singular."""
        jacobians = self.model.jacobians(q)
        try:
            return tuple(
                factorise_kkt(stack, stack.matrices(jacobians), posture=q[7:], damping=damping)
                for stack in (self.stacks[mode] for mode in modes)
            )
        except np.linalg.LinAlgError:
            return None

    def timed(self, projector: Projector, *, from_ns: int) -> TimedProjector:
        """Return the projector, valid from a task time until the next contact switch after it."""
        switch = self._motion.next_switch(from_ns)
        return TimedProjector(projector, from_ns, FOR_EVER_NS if switch is None else switch)

    def projector_for(
        self,
        q: np.ndarray,
        v: np.ndarray,
        *,
        time_ns: int,
        com_command: np.ndarray | None = None,
    ) -> TimedProjector | None:
        """Projector at (q, v) for the reference and contact mode of a task time.

        If that time lies beyond a contact switch, the coming mode is imposed on the present state,
        Sec. III-C. None if the QP has no solution.
        """
        mode = self._motion.reference(time_ns).mode
        solution, _ = self.solve(q, v, time_ns=time_ns, mode=mode, com_command=com_command)
        if solution.projector is None:
            return None
        return self.timed(solution.projector, from_ns=time_ns)
