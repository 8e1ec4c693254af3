"""Random states of a robot around its standing configuration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from shared.robots import Robot

# How far joints and base are from standing [rad], from a measured tremble to an impossible pose.
SPREADS = (0.02, 0.1, 0.3, 1.0)


class State(NamedTuple):
    """A configuration (nq,) and a velocity (nv,), Pinocchio's order."""

    q: np.ndarray
    v: np.ndarray


def random_state(robot: Robot, *, spread: float, rng: np.random.Generator) -> State:
    """One state `spread` rad away; the base moves a fifth of that in metres."""
    step = spread * rng.standard_normal(robot.model.nv)
    step[:3] *= 0.2
    v = 2.0 * spread * rng.standard_normal(robot.model.nv)
    return State(pin.integrate(robot.model, robot.q_standing, step), v)


def random_states(robot: Robot, *, count: int, rng: np.random.Generator) -> list[State]:
    """States of every spread in turn."""
    return [random_state(robot, spread=SPREADS[k % len(SPREADS)], rng=rng) for k in range(count)]
