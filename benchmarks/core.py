"""Time of the robot's tick and the edge's step by their parts, of messages and of start-up.

The parts are timed within trials (`benchmarks.in_loop`). The other back ends of the QP and the
other levels of correction are in no trial. They are timed call after call, which gives about half
the time. The states are those of a disturbed standing robot, so that active sets differ from call
to call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from benchmarks import messages
from benchmarks.in_loop import EDGE, NETWORK, NODES, WHOLE, Call, Part, ticks, timed_calls
from benchmarks.start_up import SERVICES, start_up_ns
from benchmarks.timing import Timing, header, measure, table
from shared.config.control_settings import CORRECTION_LEVELS
from shared.config.settings import RunConfig
from shared.motion.standing import Standing
from shared.output.text_table import aligned
from shared.robots import Robot, load_robot
from shared.wbc.answer import Factorisation, Projector
from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Corrector, Iterate
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.least_norm import LeastNorm
from shared.wbc.model import Jacobians, Kinematics, WholeBodyModel
from shared.wbc.projector import condense, full_problem, hold, solve
from shared.wbc.qp import DaqpSolver, ProxsuiteSolver, QuadraticProgram
from shared.wbc.stack import Stack, StackMatrices

_N_STATES = 64
_STARTS = 5
_TRIALS = (("balance", "pr"), ("balance", "la"), ("balance", "lc"), ("walk", "la"), ("walk", "lc"))
# The parts timed within the calls of the nodes, in the order of the table.
PARTS = (
    Part("robot_node.plant:MujocoPlant.state", "state of the plant"),
    Part("robot_node.sensors:Sensors.measure", "sensors"),
    Part("shared.motion.standing:Standing.reference", "reference"),
    Part("shared.motion.walking:Walking.reference", "reference of the walk"),
    Part("shared.wbc.model:WholeBodyModel.kinematics", "terms of b"),
    Part("shared.wbc.stack:Stack.right_hand_side", "b"),
    Part("shared.wire.codec:Codec.encode_state", "encode the state"),
    Part("shared.wire.codec:Codec.decode_projector", "decode a projector"),
    Part("shared.wire.codec:Codec.decode_factorisations", "decode factorisations"),
    Part("shared.wire.codec:Codec.decode_state", "decode the state"),
    Part("shared.wbc.model:WholeBodyModel.jacobians", "terms of A"),
    Part("shared.wbc.stack:Stack.matrices", "A"),
    Part("shared.wbc.whole_body:solve", "QP and projector"),
    Part("shared.wbc.qp:DaqpSolver.solve", "solver"),
    Part("shared.wbc.correction:Corrector.step", "correction"),
    Part("shared.wbc.projector:Projector.apply", "apply the projector"),
    Part("shared.wbc.assisted:recover_force", "torque"),
    Part("shared.wire.codec:Codec.rounded", "round the projector"),
    Part("shared.wire.codec:Codec.encode_projector", "encode the projector"),
    Part("robot_node.safety:TorqueGuard.accept", "guard"),
    Part("robot_node.safety:JointHold.observe", "hold"),
    Part("robot_node.tick_row:TickRow.fill", "row"),
)
_REFERENCE = "QP, all 61 unknowns, daqp cold"


@dataclass(frozen=True)
class _Case:
    """The inputs of all parts at one state."""

    q: np.ndarray
    v: np.ndarray
    kinematics: Kinematics
    jacobians: Jacobians
    matrices: StackMatrices
    b: np.ndarray
    least_norm: LeastNorm
    condensed: QuadraticProgram
    full: QuadraticProgram
    active: np.ndarray
    projector: Projector
    y: np.ndarray
    blocks: Factorisation
    iterate: Iterate
    residual: np.ndarray


def run(*, repetitions: int, seed: int, seconds: float) -> str:
    """Measure every part, and return the tables as text."""
    config = RunConfig()
    robot = load_robot(config.robot.name)
    top = header()
    return "\n".join(
        [
            f"{top}; seed {seed}",
            "",
            f"in trials of {seconds:g} s over {NETWORK}; [µs]",
            *_in_trials(seconds),
            "",
            f"call after call, {repetitions} times",
            table(_alternatives(robot, config, repetitions, seed), reference=_REFERENCE),
            "",
            f"messages to and from another process, {messages.MESSAGES} at 1 kHz; processor time",
            *aligned(messages.lines(messages.ours), left=1),
            "",
            "start-up: processor time of a service that prints its --help",
            *_start_up(),
        ]
    )


def _in_trials(seconds: float) -> list[str]:
    """Return for every trial a line per part, indented below the part that contains it."""
    lines = [["", "per tick", "p50", "p99"]]
    for task, controller in _TRIALS:
        calls = timed_calls(
            (*NODES, *PARTS), task, controller, seconds=seconds, clock=time.perf_counter_ns
        )
        lines.append([f"{task}, {controller.upper()}", "", "", ""])
        whole = ticks(calls)
        for name in (WHOLE, EDGE):
            lines.append(_part_line(f"  {name}", whole[name], len(whole[WHOLE])))
        lines += [
            _part_line("  " * (len(path) + 1) + path[-1], durations, len(whole[WHOLE]))
            for path, durations in _by_path(calls, warm_ticks=len(whole[WHOLE]))
        ]
    return aligned(lines, left=1)


def _by_path(calls: Sequence[Call], *, warm_ticks: int) -> list[tuple[tuple[str, ...], np.ndarray]]:
    """Durations of every path in the last ticks. Each part follows the part that contains it."""
    measured = [k for k, (path, _) in enumerate(calls) if path == ("measure",)]
    by_path: dict[tuple[str, ...], list[int]] = {}
    for path, duration in calls[measured[-warm_ticks - 1] + 1 :]:
        by_path.setdefault(path, []).append(duration)
    order = [part.name for part in (*NODES, *PARTS)]
    return sorted(
        ((path, np.array(each)) for path, each in by_path.items()),
        key=lambda found: [order.index(name) for name in found[0]],
    )


def _part_line(name: str, durations: np.ndarray, n_ticks: int) -> list[str]:
    p50, p99 = np.percentile(durations, [50, 99]) * 1e-3
    return [
        name,
        f"{len(durations) / n_ticks:.2f}",
        f"{p50:.1f}",
        f"{p99:.1f}",
    ]


def _start_up() -> list[str]:
    lines = [["", "p50 [s]", "least–most"]]
    for service in SERVICES:
        seconds = [start_up_ns(f"{service}.__main__") * 1e-9 for _ in range(_STARTS)]
        spread = f"{min(seconds):.2f}–{max(seconds):.2f}"
        lines.append([service, f"{np.median(seconds):.2f}", spread])
    return aligned(lines, left=1)


def _alternatives(robot: Robot, config: RunConfig, repetitions: int, seed: int) -> list[Timing]:
    model = WholeBodyModel(robot)
    stack = Stack(robot, config.wbc, ContactMode.DOUBLE_SUPPORT)
    daqp, proxsuite = DaqpSolver(), ProxsuiteSolver()
    cases = _cases(robot, stack, config, seed)

    def timed(name: str, operation: Callable[[_Case], object]) -> Timing:
        return measure(name, operation, cases, repetitions=repetitions)

    return [
        timed("least-norm form", lambda c: stack.least_norm(c.matrices)),
        timed("condense to forces", lambda c: condense(stack, c.least_norm, c.b)),
        timed("QP in forces, daqp cold", lambda c: daqp.solve(c.condensed)),
        timed(
            "QP in forces, daqp warm",
            lambda c: daqp.solve(c.condensed, warm_active=c.active),
        ),
        timed("QP in forces, proxsuite cold", lambda c: proxsuite.solve(c.condensed)),
        timed(
            "QP in forces, proxsuite warm",
            lambda c: proxsuite.solve(c.condensed, warm_active=c.active),
        ),
        timed(_REFERENCE, lambda c: daqp.solve(c.full)),
        timed("QP, all 61 unknowns, proxsuite cold", lambda c: proxsuite.solve(c.full)),
        timed("projector from active set", lambda c: hold(stack, c.least_norm, c.active)),
        timed("form + QP + projector", lambda c: solve(stack, c.matrices, c.b, solver=daqp)),
        timed(
            "form + projector, active set known",
            lambda c: solve(stack, c.matrices, c.b, solver=daqp, likely_active=c.active),
        ),
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


def _cases(robot: Robot, stack: Stack, config: RunConfig, seed: int) -> list[_Case]:
    rng = np.random.default_rng(seed)
    reference = Standing(robot).reference(0)
    daqp = DaqpSolver()
    cases = []
    for _ in range(_N_STATES):
        # A separate model for each: kinematics are those of a model's last call.
        model = WholeBodyModel(robot)
        q = pin.integrate(robot.model, robot.q_standing, 0.03 * rng.standard_normal(model.nv))
        v = 0.1 * rng.standard_normal(model.nv)
        jacobians = model.jacobians(q)
        matrices = stack.matrices(jacobians)
        b = stack.right_hand_side(model.kinematics(q, v), reference)
        least_norm = stack.least_norm(matrices)
        condensed = condense(stack, least_norm, b)
        active = daqp.solve(condensed).active
        projector = hold(stack, least_norm, active).projector
        y = projector.apply(b)
        at_solution = stack.kinematics_at(y, model=model, q=q, v=v)
        residual = stack.right_hand_side(at_solution, reference)
        cases.append(
            _Case(
                q=q,
                v=v,
                kinematics=model.kinematics(q, v),
                jacobians=jacobians,
                matrices=matrices,
                b=b,
                least_norm=least_norm,
                condensed=condensed,
                full=full_problem(stack, matrices, b),
                active=active,
                projector=projector,
                y=y,
                blocks=factorise_kkt(stack, matrices, q[7:]),
                iterate=Iterate(stack.mode, y, np.zeros(stack.equality_rows.stop)),
                residual=residual,
            )
        )
    return cases
