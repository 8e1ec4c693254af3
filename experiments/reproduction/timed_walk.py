"""Walks in lockstep with timed computations, for Table V."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from shared.config.settings import RunConfig
from shared.robots import load_robot
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA
from shared.wbc.model import WholeBodyModel
from shared.wbc.projector import solve
from shared.wbc.qp import make_solver
from shared.wbc.reference import Reference
from shared.wbc.stack import make_stacks
from shared.wbc.torque import recover_torque

# The first ticks of every walk are left out: caches and branch predictors are still cold.
WARM_UP_TICKS = 200

State = tuple[np.ndarray, np.ndarray, Reference]


class TimedWalk:
    """One walk in lockstep, with computations timed in place. All arrays begin after the warm-up.

    `states`: the states that the robot measured. `local_ns` and `tick_ns`: time per tick of the
    local controller and of the whole robot [ns]. `edge_ns`: time per answer of the edge [ns].
    """

    def __init__(self, config: RunConfig) -> None:
        lockstep = Lockstep(config, all_active_sets=False)
        observed: list[State] = []
        observe_ns = timed(lockstep.robot.controller, "observe", given=observed)
        command_ns = timed(lockstep.robot.controller, "command")
        self.result: TrialResult = lockstep.run()
        schema, rows, solves = self.result.schema, self.result.rows, self.result.solve_rows
        self.states = observed[WARM_UP_TICKS:]
        both = np.add(observe_ns[: len(command_ns)], command_ns)
        self.local_ns = both[WARM_UP_TICKS:]
        self.tick_ns = schema.column(rows, "tick_ns")[WARM_UP_TICKS:]
        warm = SOLVE_SCHEMA.column(solves, "state_sequence") >= WARM_UP_TICKS
        self.edge_ns = SOLVE_SCHEMA.column(solves, "solve_ns")[warm]
        # Free the objects of this walk now, and not during the next one.
        del lockstep
        gc.collect()

    @property
    def seconds(self) -> float:
        """Duration of the walk [s], to its end or the robot's fall."""
        return len(self.result.rows) * 1e-3

    def message_bytes(self, direction: int) -> np.ndarray:
        """Sizes of the messages sent in a direction [bytes]."""
        rows = self.result.link_rows
        sent = LINK_SCHEMA.column(rows, "direction") == direction
        return LINK_SCHEMA.column(rows[sent], "bytes")


def timed(owner: object, name: str, *, given: list[Any] | None = None) -> list[int]:
    """Time the calls of a method from now on. Return the growing list of durations [ns].

    The positional arguments of each call are appended to `given`.
    """
    method = getattr(owner, name)
    durations: list[int] = []

    def timed_method(*args: Any, **kwargs: Any) -> Any:
        if given is not None:
            given.append(args)
        started = time.perf_counter_ns()
        result = method(*args, **kwargs)
        durations.append(time.perf_counter_ns() - started)
        return result

    setattr(owner, name, timed_method)
    return durations


def full_controller(
    config: RunConfig, states: Sequence[State], repetitions: int
) -> tuple[np.ndarray, np.ndarray]:
    """Durations of the QP and of the full controller [ns], each of shape (repetitions, states).

    The full controller is the computation of a robot without an edge at these states. It contains
    the QP.
    """
    robot = load_robot(config.robot.name)
    model = WholeBodyModel(robot)
    stacks = make_stacks(robot, config.wbc)
    solver = make_solver(config.wbc.solver)
    qp_ns, full_ns = np.empty((2, repetitions, len(states)))
    for r in range(repetitions):
        for k, (q, v, reference) in enumerate(states):
            stack = stacks[reference.mode]
            started = time.perf_counter_ns()
            b = stack.right_hand_side(model.kinematics(q, v), reference)
            matrices = stack.matrices(model.jacobians(q))
            posed = time.perf_counter_ns()
            projector = solve(stack, matrices, b, solver=solver).projector
            solved = time.perf_counter_ns()
            if projector is not None:
                recover_torque(model, stack.contacts, q, v, projector.apply(b))
            full_ns[r, k] = time.perf_counter_ns() - started
            qp_ns[r, k] = solved - posed
    return qp_ns, full_ns


@contextlib.contextmanager
def one_core() -> Iterator[bool]:
    """Use one core and no garbage collection. Yield whether the system allowed the one core."""
    before: set[int] | None = None
    with contextlib.suppress(AttributeError, OSError):
        allowed = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {max(allowed)})
        before = allowed
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield before is not None
    finally:
        gc.enable()
        gc.unfreeze()
        if before is not None:
            os.sched_setaffinity(0, before)
