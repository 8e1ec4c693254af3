"""The controller's parts, the whole robot tick, the whole edge step, and lockstep speed.

States are taken from a disturbed standing robot, so that active sets differ from call to call.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from benchmarks.timing import Timing, header, measure, table
from edge_node.node import EdgeNode
from experiments.lockstep import Lockstep
from robot_node.node import RobotNode
from shared.config.config_file import load_config
from shared.config.controllers import CONTROLLERS
from shared.config.settings import CORRECTION_LEVELS, RunConfig
from shared.motion.standing import Standing
from shared.robots import Robot, load_robot
from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Corrector, Factorisation, Iterate, factorise_kkt
from shared.wbc.model import Jacobians, Kinematics, WholeBodyModel
from shared.wbc.projector import (
    CondensedQp,
    Projector,
    condense,
    factorise,
    full_problem,
    solve,
)
from shared.wbc.qp import DaqpSolver, ProxsuiteSolver, QuadraticProgram
from shared.wbc.stack import Stack, StackMatrices
from shared.wbc.torque import recover_torque

_N_STATES = 64
_REFERENCE = "QP, all 61 unknowns, daqp cold"


@dataclass(frozen=True)
class _Case:
    """Everything that the parts need at one state."""

    q: np.ndarray
    v: np.ndarray
    kinematics: Kinematics
    jacobians: Jacobians
    matrices: StackMatrices
    b: np.ndarray
    condensed: CondensedQp
    full: QuadraticProgram
    active: np.ndarray
    projector: Projector
    y: np.ndarray
    blocks: Factorisation
    iterate: Iterate
    residual: np.ndarray


def run(*, repetitions: int, seed: int) -> str:
    """Measure everything; the table as text."""
    config = RunConfig()
    robot = load_robot(config.robot.name)
    top = header()
    timings = [*_parts(robot, config, repetitions, seed), *_nodes(robot, config, repetitions)]
    return "\n".join(
        [
            f"{top}; seed {seed}, {repetitions} repetitions",
            "",
            table(timings, reference=_REFERENCE),
            "",
            _lockstep(),
        ]
    )


def _parts(robot: Robot, config: RunConfig, repetitions: int, seed: int) -> list[Timing]:
    model = WholeBodyModel(robot)
    stack = Stack(robot, config.wbc, ContactMode.DOUBLE_SUPPORT)
    reference = Standing(robot).reference(0)
    daqp, proxsuite = DaqpSolver(), ProxsuiteSolver()
    cases = _cases(robot, model, stack, config, seed)

    def timed(name: str, operation: Callable[[_Case], object]) -> Timing:
        return measure(name, operation, cases, repetitions=repetitions)

    return [
        timed("terms of b (robot)", lambda c: model.kinematics(c.q, c.v)),
        timed("b", lambda c: stack.right_hand_side(c.kinematics, reference)),
        timed("terms of A (edge)", lambda c: model.jacobians(c.q)),
        timed("A", lambda c: stack.matrices(c.jacobians)),
        timed("condense to forces", lambda c: condense(stack, c.matrices, c.b)),
        timed("QP in forces, daqp cold", lambda c: daqp.solve(c.condensed.problem)),
        timed(
            "QP in forces, daqp warm",
            lambda c: daqp.solve(c.condensed.problem, warm_active=c.active),
        ),
        timed("QP in forces, proxsuite cold", lambda c: proxsuite.solve(c.condensed.problem)),
        timed(
            "QP in forces, proxsuite warm",
            lambda c: proxsuite.solve(c.condensed.problem, warm_active=c.active),
        ),
        timed(_REFERENCE, lambda c: daqp.solve(c.full)),
        timed("QP, all 61 unknowns, proxsuite cold", lambda c: proxsuite.solve(c.full)),
        timed("projector from active set", lambda c: factorise(stack, c.condensed, c.active)),
        timed("condense + QP + projector", lambda c: solve(stack, c.matrices, c.b, solver=daqp)),
        timed("apply projector", lambda c: c.projector.apply(c.b)),
        timed("torque recovery", lambda c: recover_torque(model, stack.contacts, c.q, c.v, c.y)),
        timed("blocks of the KKT inverse", lambda c: factorise_kkt(stack, c.matrices, c.q[7:])),
        timed("corrector from the blocks", lambda c: Corrector(stack, c.blocks, level="b")),
        *(
            timed(f"correction, level {level}", step)
            for level, step in _corrections(robot, model, stack)
        ),
    ]


def _corrections(
    robot: Robot, model: WholeBodyModel, stack: Stack
) -> list[tuple[str, Callable[[_Case], object]]]:
    """A step of each level with the factorisation of the standing robot."""
    matrices = stack.matrices(model.jacobians(robot.q_standing))
    blocks = factorise_kkt(stack, matrices, robot.q_standing[7:])

    def step_of(level: str) -> Callable[[_Case], object]:
        corrector = Corrector(stack, blocks, level=level)
        return lambda c: corrector.step(c.iterate, c.residual, model, c.kinematics)

    return [(level, step_of(level)) for level in CORRECTION_LEVELS]


def _cases(
    robot: Robot, model: WholeBodyModel, stack: Stack, config: RunConfig, seed: int
) -> list[_Case]:
    rng = np.random.default_rng(seed)
    reference = Standing(robot).reference(0)
    daqp = DaqpSolver()
    cases = []
    for _ in range(_N_STATES):
        q = pin.integrate(robot.model, robot.q_standing, 0.03 * rng.standard_normal(model.nv))
        v = 0.1 * rng.standard_normal(model.nv)
        kinematics, jacobians = model.kinematics(q, v), model.jacobians(q)
        matrices = stack.matrices(jacobians)
        b = stack.right_hand_side(kinematics, reference)
        condensed = condense(stack, matrices, b)
        active = daqp.solve(condensed.problem).active
        projector = factorise(stack, condensed, active)
        y = projector.apply(b)
        at_solution = stack.kinematics_at(y, model=model, q=q, v=v)
        cases.append(
            _Case(
                q=q,
                v=v,
                kinematics=kinematics,
                jacobians=jacobians,
                matrices=matrices,
                b=b,
                condensed=condensed,
                full=full_problem(stack, matrices, b),
                active=active,
                projector=projector,
                y=y,
                blocks=factorise_kkt(stack, matrices, q[7:]),
                iterate=Iterate(stack.mode, y, np.zeros(stack.equality_rows.stop)),
                residual=stack.right_hand_side(at_solution, reference),
            )
        )
    return cases


def _nodes(robot: Robot, config: RunConfig, repetitions: int) -> list[Timing]:
    """Whole tick and whole step in closed loop, codec included, plant excluded."""
    timings = []
    for controller in CONTROLLERS:
        changed = dataclasses.replace(config, controller=controller)
        timings += _node(robot, changed, repetitions)
    return timings


def _node(robot: Robot, config: RunConfig, repetitions: int) -> list[Timing]:
    robot_node = RobotNode(robot, config, Standing(robot), session=1)
    edge_node = EdgeNode(robot, config, Standing(robot))
    ticks, steps, plant = (np.empty(repetitions) for _ in range(3))
    up = down = 0
    for k in range(repetitions):
        start = time.perf_counter_ns()
        state = robot_node.measure(0)
        measured = time.perf_counter_ns()
        edge_node.receive(state)
        answer = edge_node.step()
        answered = time.perf_counter_ns()
        if answer is not None and answer.data is not None:
            robot_node.receive(answer.data)
            down = max(down, len(answer.data))
        command = robot_node.command(0)
        ticks[k] = measured - start + time.perf_counter_ns() - answered
        steps[k] = answered - measured
        commanded = time.perf_counter_ns()
        robot_node.advance(command)
        plant[k] = time.perf_counter_ns() - commanded
        up = max(up, len(state))
    name = config.controller.upper()
    return [
        Timing.of(f"{name} robot tick: measure, receive, command", ticks),
        Timing.of(f"{name} edge step (at most {up} B in, {down} B out)", steps),
        Timing.of(f"{name} plant: MuJoCo step, standing", plant),
    ]


def _lockstep() -> str:
    config = load_config(None, {"controller": "la", "link.network": "constant:50ms"})
    factor = Lockstep(config).run().summary["realtime_factor"]
    return f"lockstep balance, LA, 50 ms: {factor:.2f} × real time"
