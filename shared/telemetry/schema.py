"""The columns of the robot's, the link's and the edge's rows, and of the footprints."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np


class Source(enum.IntEnum):
    """The source of a command.

    `FRESH`: the answer to this tick's state. `CACHED`: an older answer, as it is. `HELD`: none, a
    joint hold. `ON_BOARD`: the on-board computer. `CORRECTED`: an older answer, corrected.
    `STOPPING`: the same, while the robot ends its walk.
    """

    FRESH = 0
    CACHED = 1
    HELD = 2
    ON_BOARD = 3
    CORRECTED = 4
    STOPPING = 5

    @property
    def label(self) -> str:
        """Its name in summaries, in the terminal and in the view."""
        return self.name.lower()


class FootprintKind(enum.IntEnum):
    """The kind of a footprint in the rows of a robot that steps by touch.

    `PLANNED`: a footprint of the edge's plan. `CHOSEN`: the foothold that the step law has chosen
    for the swing foot. `LANDED`: the place of a sole that begins to bear.
    """

    PLANNED = 0
    CHOSEN = 1
    LANDED = 2


@dataclass(frozen=True)
class Column:
    """One column: a scalar (`width` 1) or a fixed-size vector; `kind` is its Parquet type.

    `unit` and `help` are for the reference of columns. A file does not contain them.
    """

    name: str
    width: int = 1
    kind: str = "float64"
    unit: str = field(default="", compare=False, kw_only=True)
    help: str = field(default="", compare=False, kw_only=True)


class Schema:
    """Columns laid side by side in rows of float64; `slices[name]` finds one."""

    def __init__(self, *columns: Column) -> None:
        self.columns = columns
        self.slices: dict[str, slice] = {}
        start = 0
        for column in columns:
            self.slices[column.name] = slice(start, start + column.width)
            start += column.width
        self.width = start

    def column(self, rows: np.ndarray, name: str) -> np.ndarray:
        """Return the values of a column: (n,) for a scalar, (n, width) for a vector."""
        values = rows[:, self.slices[name]]
        return values[:, 0] if values.shape[1] == 1 else values


def tick_schema(*, nq: int, nv: int) -> Schema:
    """Return the schema of the robot's telemetry: a row per tick."""
    integer, small = "int64", "int8"
    return Schema(
        Column("tick", kind=integer, help="number of the tick"),
        Column(
            "time_ns",
            kind=integer,
            unit="ns",
            help="time of the task; negative while the robot waits for the edge",
        ),
        Column("wall_ns", kind=integer, unit="ns", help="robot's clock at the measurement"),
        Column("source", kind=small, help="source of the command, a `Source`"),
        Column("mode", kind=small, help="planned contact mode: 0 double, 1 left, 2 right support"),
        Column("q", nq, unit="m, rad", help="true configuration, in Pinocchio's order"),
        Column("v", nv, unit="m/s, rad/s", help="true velocity, in Pinocchio's order"),
        Column("tau", nv - 6, unit="N m", help="commanded joint torques, after the clamp"),
        Column(
            "f",
            24,
            unit="N",
            help="commanded forces at the four points of the left, then the right sole, in the "
            "sole's frame; 0 for a foot without load",
        ),
        Column("com", 3, unit="m", help="true CoM, in the world"),
        Column("com_reference", 3, unit="m", help="reference of the CoM, in the world"),
        Column("com_error_m", unit="m", help="distance of the CoM from its reference"),
        Column(
            "contact_violation_m_s2",
            unit="m/s²",
            help="norm of J_c a + J̇_c v + k_d J_c v for the commanded a at the measured state",
        ),
        Column("push_n", 3, unit="N", help="push on the base, in the world"),
        Column(
            "foot_slip_m",
            2,
            unit="m",
            help="slip of the left and the right sole since it was loaded; NaN in the air",
        ),
        Column(
            "plan_in_world",
            3,
            unit="m, m, rad",
            help="frame of the plan in the world: x, y and heading",
        ),
        Column(
            "plan_time_ns",
            kind=integer,
            unit="ns",
            help="time of the plan, which a joint hold may advance",
        ),
        Column(
            "projector_age_ns",
            kind=integer,
            unit="ns",
            help="age of the answer behind the command; −1 without one",
        ),
        Column(
            "projector_sequence",
            kind=integer,
            help="tick whose state that answer is for; −1 without one",
        ),
        Column(
            "active_set",
            kind=integer,
            help="active rows of C in the command: bit 20 k + i for row i of foot k, left before "
            "right; −1 without an answer",
        ),
        Column("on_board_qps", kind=integer, help="QPs begun on board so far"),
        Column(
            "contraction",
            help="estimated contraction of LC's correction; NaN without a correction",
        ),
        Column(
            "staleness_rad",
            unit="rad",
            help="largest distance of a joint from its position at LC's factorisation; NaN "
            "without a correction",
        ),
        Column("torque_ratio", help="largest torque over the clamp; 1 where the robot clamps it"),
        Column(
            "joint_beyond_rad",
            unit="rad",
            help="largest distance of a joint beyond the URDF's range; negative within",
        ),
        Column("joint_speed_ratio", help="largest speed of a joint over the URDF's velocity limit"),
        Column(
            "contact_force_n",
            6,
            unit="N",
            help="measured force on the left and the right foot, in the world; NaN if not measured",
        ),
        Column("tick_ns", kind=integer, unit="ns", help="duration of the tick's computation"),
        Column("late_ns", kind=integer, unit="ns", help="lateness of the tick's start"),
        Column("overruns", kind=integer, help="ticks left out so far"),
        Column("refused", kind=integer, help="messages refused so far"),
    )


LINK_SCHEMA = Schema(
    Column("wall_ns", kind="int64", unit="ns", help="sending of the message, by the shim's clock"),
    Column("direction", kind="int8", help="0 uplink, 1 downlink"),
    Column("sequence", kind="int64", help="number of the message, by its sender"),
    Column("bytes", kind="int64", unit="bytes", help="size of the message"),
    Column("nominal_ns", kind="int64", unit="ns", help="delay by the profile"),
    Column(
        "achieved_ns",
        kind="int64",
        unit="ns",
        help="delay from the sending to the delivery; −1 if the message was dropped",
    ),
)
"""A row per message through the shim."""

SOLVE_SCHEMA = Schema(
    Column(
        "wall_ns",
        kind="int64",
        unit="ns",
        help="robot's clock at the solve; that of an edge elsewhere",
    ),
    Column("state_sequence", kind="int64", help="tick of the state"),
    Column("solve_ns", kind="int64", unit="ns", help="duration of the solve"),
    Column("status", kind="int8", help="index in `shared.wbc.qp.QpStatus`"),
    Column("iterations", kind="int64", help="iterations of the solver"),
    Column(
        "active_set",
        kind="int64",
        help="active rows of C at the optimum, as in the robot's rows; −1 without a solution",
    ),
)
"""A row per state that the edge worked on."""

STEP_SCHEMA = Schema(
    Column("wall_ns", kind="int64", unit="ns", help="robot's clock at the measurement"),
    Column(
        "time_ns",
        kind="int64",
        unit="ns",
        help="time of the task; negative while the robot waits for the edge",
    ),
    Column(
        "kind",
        kind="int8",
        help="0 planned by the edge, 1 chosen by the step law, 2 landed: a `FootprintKind`",
    ),
    Column("plan", kind="int64", help="number of the plan; −1 for a step of no plan"),
    Column("place", kind="int64", help="phase of the plan, from 0; −1 for a step of no plan"),
    Column("foot", kind="int8", help="0 left, 1 right"),
    Column("position", 3, unit="m", help="origin of the sole's frame, in the world"),
    Column("yaw", unit="rad", help="heading of the sole, in the world"),
    Column("landing_ns", kind="int64", unit="ns", help="expected or actual landing, in task time"),
)
"""A row per footprint of a robot that steps by touch: planned, chosen, or landed.

A plan gives a row for each of its footprints when the robot takes it. A row of another plan, or of
none, voids the rest of a plan. A foothold that moves gives another row. The robot begins with a
landed sole for each foot, of no plan.
"""
