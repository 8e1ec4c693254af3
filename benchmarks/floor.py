"""Lower bound of a tick and of an edge's step in Python: the calls that neither can avoid.

The calls are bare ones of Pinocchio, LAPACK, daqp and Zenoh, and the move of a message's bytes.
They run one after the other on warm caches. No tick takes less than the sum of its calls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import daqp
import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf

from benchmarks import messages
from benchmarks.timing import Timing, header, measure
from shared.config.settings import RunConfig
from shared.output.text_table import aligned
from shared.robots import load_robot
from shared.robots.description import Foot, sole_frame_name
from shared.telemetry.schema import tick_schema

# Unknowns and rows of b in double support, and equalities of the QP.
_UNKNOWNS, _ROWS, _EQUALITIES, _FORCES, _INEQUALITIES = 61, 56, 18, 24, 40


def run(*, repetitions: int) -> str:
    """Measure, and return the tables as text."""
    top = header()
    lines = [["", "p50 [µs]", "p99 [µs]"]]
    timings = {timing.name: timing for timing in _calls(repetitions)}
    lines += [_line(timing) for timing in timings.values()]
    sums = [
        f"{name}: {1e3 * sum(timings[part].p50_ms for part in parts):.0f} µs of {', '.join(parts)}"
        for name, parts in SUMS.items()
    ]
    return "\n".join(
        [
            f"{top}; {repetitions} repetitions",
            "",
            *aligned(lines, left=1),
            "",
            *sums,
            "",
            f"bare Zenoh, {messages.MESSAGES} messages at 1 kHz; processor time",
            *aligned(messages.lines(messages.bare), left=1),
        ]
    )


SUMS = {
    "LA tick": (
        "bias forces",
        "CoM and accelerations",
        "copy 28 kB",
        "A† b",
        "inverse dynamics",
        "a row of telemetry",
    ),
    "LC tick": (
        "bias forces",
        "CoM and accelerations",
        "inverse dynamics",
        "CoM and accelerations",
        "A† b",
        "inverse dynamics",
        "a row of telemetry",
    ),
    "edge step": (
        "bias forces",
        "CoM and accelerations",
        "inertia matrix",
        "joint Jacobians",
        "Cholesky, 18 × 18",
        "QP of 24 forces, daqp",
        "product for A†",
        "A† b",
        "copy 28 kB",
    ),
}


def _line(timing: Timing) -> list[str]:
    return [timing.name, f"{1e3 * timing.p50_ms:.1f}", f"{1e3 * timing.p99_ms:.1f}"]


def _calls(repetitions: int) -> list[Timing]:
    robot = load_robot(RunConfig().robot.name)
    model, data = robot.model, robot.model.createData()
    rng = np.random.default_rng(0)
    states = [
        (
            pin.integrate(model, robot.q_standing, 0.03 * rng.standard_normal(model.nv)),
            0.1 * rng.standard_normal(model.nv),
        )
        for _ in range(64)
    ]
    a = np.zeros(model.nv)
    forces = pin.StdVec_Force()
    for _ in range(model.njoints):
        forces.append(pin.Force.Zero())
    soles = [model.getFrameId(sole_frame_name(foot)) for foot in Foot]
    A_dagger, b, y = rng.random((_UNKNOWNS, _ROWS)), rng.random(_ROWS), np.empty(_UNKNOWNS)
    message, copied = bytes(A_dagger.nbytes), bytearray(A_dagger.nbytes)
    S = rng.random((_EQUALITIES, _EQUALITIES))
    S = S @ S.T + np.eye(_EQUALITIES)
    row = np.empty(tick_schema(nq=model.nq, nv=model.nv).width)
    values = rng.random(row.shape)
    y_from_f, f_from_b = rng.random((_UNKNOWNS, _FORCES)), rng.random((_FORCES, _ROWS))
    problem = _problem(rng)

    def copy() -> None:
        copied[:] = message

    calls: dict[str, Callable[[np.ndarray, np.ndarray], object]] = {
        "bias forces": lambda q, v: pin.nonLinearEffects(model, data, q, v),
        "CoM and accelerations": lambda q, v: pin.centerOfMass(model, data, q, v, a, False),
        "a sole's acceleration": lambda q, v: pin.getFrameAcceleration(
            model, data, soles[0], pin.LOCAL
        ),
        "inverse dynamics": lambda q, v: pin.rnea(model, data, q, v, a, forces),
        "inertia matrix": lambda q, v: pin.crba(model, data, q),
        "joint Jacobians": lambda q, v: pin.computeJointJacobians(model, data, q),
        "A† b": lambda q, v: np.dot(A_dagger, b, out=y),
        "copy 28 kB": lambda q, v: copy(),
        "a row of telemetry": lambda q, v: np.copyto(row, values),
        "Cholesky, 18 × 18": lambda q, v: dpotrf(S, lower=1),
        "QP of 24 forces, daqp": lambda q, v: daqp.solve(*problem),
        "product for A†": lambda q, v: np.dot(y_from_f, f_from_b),
    }
    return [_timed(name, call, states, repetitions) for name, call in calls.items()]


def _timed(
    name: str,
    call: Callable[[np.ndarray, np.ndarray], object],
    states: Sequence[tuple[np.ndarray, np.ndarray]],
    repetitions: int,
) -> Timing:
    return measure(name, lambda state: call(*state), states, repetitions=repetitions)


def _problem(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """A QP of the size of the QP in the forces. None of its rows becomes active."""
    H = rng.random((_FORCES, _FORCES))
    H = H @ H.T + np.eye(_FORCES)
    rows = rng.random((_INEQUALITIES, _FORCES))
    upper, lower = np.full(_INEQUALITIES, 1e30), np.full(_INEQUALITIES, -1e30)
    sense = np.zeros(_INEQUALITIES, dtype=np.int32)
    return H, rng.random(_FORCES), rows, upper, lower, sense
