"""Messages of the link as tests need them: good ones, and the same with fields changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgpack
import numpy as np

from robot_node.sent_states import SentStates
from shared.robots import Robot
from shared.wbc.answer import Factorisation, Projector, TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.stack import Stack
from shared.wire.messages import (
    FactorisationMessage,
    ProjectorMessage,
    RobotState,
)

FOR_EVER_NS = 2**62
STAMP_NS = 11_000_000


def make_state(robot: Robot, **changes: Any) -> RobotState:
    """A robot standing at rest."""
    state = RobotState(
        session=5,
        sequence=3,
        stamp_ns=STAMP_NS,
        time_ns=1_000_000,
        mode=ContactMode.DOUBLE_SUPPORT,
        q=robot.q_standing.copy(),
        v=np.zeros(robot.model.nv),
    )
    return dataclasses.replace(state, **changes)


def sent_states(
    newest: int = 10,
    *,
    stamps_ns: Mapping[int, int] | None = None,
    state: tuple[np.ndarray, np.ndarray] | None = None,
) -> SentStates:
    """States 0 to `newest` as a robot remembers them, all at (q, v) and at the time of the messages
    above, but for those in `stamps_ns`.
    """
    q, v = (np.zeros(38), np.zeros(37)) if state is None else state
    states = SentStates(len(v) - 6)
    for sequence in range(newest + 1):
        stamp_ns = (stamps_ns or {}).get(sequence, STAMP_NS)
        states.add(sequence, stamp_ns=stamp_ns, q=q, v=v)
    return states


def make_projector(stack: Stack, rng: np.random.Generator) -> Projector:
    """Random numbers in the shape of a projector, with three active rows."""
    layout = stack.layout
    return Projector(
        mode=stack.mode,
        A_dagger=rng.standard_normal((layout.n_unknowns, layout.n_rows)),
        active=np.array([1, 4, len(stack.contacts.l) - 1]),
    )


def make_answer(stack: Stack, rng: np.random.Generator, **changes: Any) -> ProjectorMessage:
    """An answer with one random projector, valid for ever."""
    layout = stack.layout
    message = ProjectorMessage(
        session=5,
        sequence=3,
        stamp_ns=STAMP_NS,
        mode=stack.mode,
        tau=10.0 * rng.standard_normal(layout.n_accelerations - 6),
        y=100.0 * rng.standard_normal(layout.n_unknowns),
        projectors=(TimedProjector(make_projector(stack, rng), 0, FOR_EVER_NS),),
    )
    return dataclasses.replace(message, **changes)


def make_factorisation(stack: Stack, rng: np.random.Generator, **changes: Any) -> Factorisation:
    """Random numbers in the shape of a factorisation; P is positive definite, as a true one's
    block of the forces is. Rows of A that do not vary are what they always are.
    """
    n, n_e = stack.layout.n_unknowns, stack.equality_rows.stop
    n_a = stack.layout.n_accelerations
    A = stack.constant_task_rows.copy()
    A[stack.varying_task_rows] = rng.standard_normal((len(stack.varying_task_rows), n_a))
    factorisation = Factorisation(
        mode=stack.mode,
        P=_symmetric(n, rng),
        Q=rng.standard_normal((n, n_e)),
        T=_symmetric(n_e, rng),
        A=A,
        posture=rng.standard_normal(n_a - 6),
    )
    return dataclasses.replace(factorisation, **changes)


def _symmetric(n: int, rng: np.random.Generator) -> np.ndarray:
    factor = rng.standard_normal((n, n))
    return np.eye(n) + factor @ factor.T / n


def make_correction(
    stacks: Iterable[Stack], rng: np.random.Generator, **changes: Any
) -> FactorisationMessage:
    """An answer to a robot that corrects, with one random factorisation per stack."""
    message = FactorisationMessage(
        session=5,
        sequence=3,
        stamp_ns=STAMP_NS,
        factorisations=tuple(make_factorisation(stack, rng) for stack in stacks),
    )
    return dataclasses.replace(message, **changes)


def altered(data: bytes, change: Callable[[dict[str, Any]], Any]) -> bytes:
    """The payload with its fields changed in place by `change`."""
    fields = msgpack.unpackb(data)
    change(fields)
    return bytes(msgpack.packb(fields))
