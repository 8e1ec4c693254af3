"""The columns of the robot's, the link's and the edge's rows."""

from __future__ import annotations

import enum
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Column:
    """One column: a scalar (`width` 1) or a fixed-size vector; `kind` is its Parquet type."""

    name: str
    width: int = 1
    kind: str = "float64"


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


# One row per tick of the robot. Times in ns: `time_ns` of the task (negative while waiting for the
# edge), `wall_ns` of the robot's clock. `source` is a `Source`.
# `q`, `v` true state, Pinocchio order; `f` commanded forces at the four points of both soles, zero
# where unloaded [N].
# `foot_slip_m` of the left and right foot since it was loaded, NaN in the air. `plan_in_world`: the
# plan's frame, x, y [m] and heading [rad]; `plan_time_ns`: the plan's time, which a joint hold may
# advance (`docs/maths.md`). `com_reference` is in the world. `active_set` and
# `projector_sequence` are those of the command's projector: its bit mask (`Projector.active_set`)
# and the tick whose state it came from; −1 if none. `on_board_qps`: QPs begun on board so far.
# `contraction`, `staleness_rad`: as in `robot_node.controllers.Decision`, NaN if not corrected.
def tick_schema(*, nq: int, nv: int) -> Schema:
    """Return the schema of a robot's telemetry."""
    return Schema(
        Column("tick", kind="int64"),
        Column("time_ns", kind="int64"),
        Column("wall_ns", kind="int64"),
        Column("source", kind="int8"),
        Column("mode", kind="int8"),
        Column("q", nq),
        Column("v", nv),
        Column("tau", nv - 6),
        Column("f", 24),
        Column("com", 3),
        Column("com_reference", 3),
        Column("com_error_m"),
        Column("contact_violation_m_s2"),
        Column("push_n", 3),
        Column("foot_slip_m", 2),
        Column("plan_in_world", 3),
        Column("plan_time_ns", kind="int64"),
        Column("projector_age_ns", kind="int64"),
        Column("projector_sequence", kind="int64"),
        Column("active_set", kind="int64"),
        Column("on_board_qps", kind="int64"),
        Column("contraction"),
        Column("staleness_rad"),
        Column("tick_ns", kind="int64"),
        Column("late_ns", kind="int64"),
        Column("overruns", kind="int64"),
        Column("refused", kind="int64"),
    )


# One row per message through the shim. `direction` 0 up, 1 down; `achieved_ns` is −1 if dropped.
LINK_SCHEMA = Schema(
    Column("wall_ns", kind="int64"),
    Column("direction", kind="int8"),
    Column("sequence", kind="int64"),
    Column("bytes", kind="int64"),
    Column("nominal_ns", kind="int64"),
    Column("achieved_ns", kind="int64"),
)

# One row per state the edge worked on. `status` is the index in `shared.wbc.qp.QpStatus`;
# `active_set` as `Projector.active_set`, −1 without a solution.
SOLVE_SCHEMA = Schema(
    Column("wall_ns", kind="int64"),
    Column("state_sequence", kind="int64"),
    Column("solve_ns", kind="int64"),
    Column("status", kind="int8"),
    Column("iterations", kind="int64"),
    Column("active_set", kind="int64"),
)
