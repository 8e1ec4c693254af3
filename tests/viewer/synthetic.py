"""Telemetry of a robot that stands and sways, without a simulation: input for viewer tests."""

from __future__ import annotations

import numpy as np

from shared.robots import Robot
from shared.telemetry.schema import (
    LINK_SCHEMA,
    SOLVE_SCHEMA,
    STEP_SCHEMA,
    FootprintKind,
    Schema,
    tick_schema,
)
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel

WALL_START_NS = 5_000_000_000_000
PERIOD_NS = 1_000_000


def tick_rows(
    robot: Robot, n: int, *, waiting: int = 0, start: int = 0
) -> tuple[Schema, np.ndarray]:
    """Rows of ticks `start` … `start + n`; the first `waiting` of the run await the edge."""
    schema = tick_schema(nq=robot.model.nq, nv=robot.model.nv)
    model = WholeBodyModel(robot)
    rows = np.zeros((n, schema.width))
    standing_com = model.kinematics(robot.q_standing, np.zeros(robot.model.nv)).com
    weight_per_point = robot.mass * 9.81 / 8
    for k in range(n):
        tick = start + k
        t = max(0, tick - waiting) * 1e-3
        q = robot.q_standing.copy()
        q[1] += 0.03 * np.sin(2.0 * t)
        q[7:] += 0.03 * np.sin(3.0 * t)
        com = model.kinematics(q, np.zeros(robot.model.nv)).com
        share = 1.0 + 0.6 * np.sin(2.0 * t)
        f = np.zeros((8, 3))
        f[:4, 2], f[4:, 2] = weight_per_point * share, weight_per_point * (2.0 - share)
        f[:, 1] = 0.1 * f[:, 2]
        values = {
            "tick": tick,
            "time_ns": (tick - waiting) * PERIOD_NS if tick >= waiting else -1,
            "plan_time_ns": max(0, tick - waiting) * PERIOD_NS,
            "wall_ns": WALL_START_NS + tick * PERIOD_NS,
            "source": 2 if tick < waiting else (0 if int(t * 4) % 2 else 1),
            "mode": ContactMode.DOUBLE_SUPPORT,
            "q": q,
            "f": f.ravel(),
            "com": com,
            "com_reference": standing_com,
            "com_error_m": np.linalg.norm(com - standing_com),
            "contact_violation_m_s2": 0.2 + 0.1 * np.sin(40.0 * t),
            "push_n": (0.0, 100.0 if 1.0 <= t < 1.2 else 0.0, 0.0),
            "projector_age_ns": 3e6 + 60e6 * (t % 0.5),
            "tick_ns": 4e5 + 1e5 * np.sin(17.0 * t) ** 2,
            "late_ns": 2e4,
        }
        for name, value in values.items():
            rows[k, schema.slices[name]] = value
    return schema, rows


def link_rows(n: int, *, lost_every: int = 0, start: int = 0) -> tuple[Schema, np.ndarray]:
    """`n` messages up and `n` down, one per millisecond; each `lost_every`-th of them lost."""
    rows = np.zeros((2 * n, LINK_SCHEMA.width))
    for k in range(2 * n):
        tick, direction = start + k // 2, k % 2
        nominal_ns = 15e6 * (1 + direction) + (60e6 if tick % 1000 > 800 else 0.0)
        lost = lost_every and tick % lost_every == 0
        achieved_ns = -1 if lost else nominal_ns + 1e5
        wall_ns = WALL_START_NS + tick * PERIOD_NS
        rows[k] = [wall_ns, direction, tick, 900, nominal_ns, achieved_ns]
    return LINK_SCHEMA, rows


def solve_rows(n: int, *, start: int = 0) -> tuple[Schema, np.ndarray]:
    """`n` solves, one per millisecond."""
    rows = np.zeros((n, SOLVE_SCHEMA.width))
    ticks = start + np.arange(n)
    rows[:, 0] = WALL_START_NS + ticks * PERIOD_NS
    rows[:, 1] = ticks
    rows[:, 2] = 9e5 + 3e5 * np.sin(ticks / 50.0)
    return SOLVE_SCHEMA, rows


def step_row(
    kind: FootprintKind,
    *,
    at: int,
    foot: int,
    x: float,
    step: tuple[int, int] = (-1, -1),
    z: float = 0.0,
) -> np.ndarray:
    """A footprint at a tick of the task, `x` ahead, of a `step`: a plan and the place in it."""
    row = np.zeros(STEP_SCHEMA.width)
    values: dict[str, float | tuple[float, ...]] = {
        "wall_ns": WALL_START_NS + at * PERIOD_NS,
        "time_ns": at * PERIOD_NS,
        "kind": kind,
        "plan": step[0],
        "place": step[1],
        "foot": foot,
        "position": (x, 0.1 - 0.2 * foot, z),
    }
    for name, value in values.items():
        row[STEP_SCHEMA.slices[name]] = value
    return row


def step_rows() -> tuple[Schema, np.ndarray]:
    """A robot on its feet takes a plan of two steps, and another as its left foot has landed.

    Then it steps as no plan says. Rows are at 0, 20, 40, 60, 80 and 100 ms.
    """
    planned, chosen, landed = FootprintKind
    rows = [
        step_row(landed, at=0, foot=0, x=0.0),
        step_row(landed, at=0, foot=1, x=0.0),
        step_row(planned, at=20, foot=0, x=0.1, step=(4, 1)),
        step_row(planned, at=20, foot=1, x=0.2, step=(4, 3), z=0.06),
        step_row(chosen, at=40, foot=0, x=0.15, step=(4, 1)),
        step_row(landed, at=60, foot=0, x=0.14, step=(4, 1)),
        step_row(planned, at=80, foot=1, x=0.3, step=(5, 1)),
        step_row(chosen, at=100, foot=1, x=0.35),
    ]
    return STEP_SCHEMA, np.array(rows)
