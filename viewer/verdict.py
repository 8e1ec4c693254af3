"""The verdict on a watched robot: it waits for the edge, stands, or has fallen."""

from __future__ import annotations

import numpy as np

from shared.robots import Robot
from shared.robots.fallen import has_fallen
from shared.telemetry.schema import Schema
from shared.wbc.model import WholeBodyModel

WAITS, STANDS = "waits for the edge", "stands"


class Verdict:
    """The verdict after the rows that it has taken in. `text` is the verdict in words."""

    def __init__(self, robot: Robot) -> None:
        standing = WholeBodyModel(robot).kinematics(robot.q_standing, np.zeros(robot.model.nv))
        self._standing_com_height = float(standing.com[2])
        self._fell_ns: int | None = None
        self.text = WAITS

    @property
    def fallen(self) -> bool:
        """Return whether the robot has fallen."""
        return self._fell_ns is not None

    def take(self, schema: Schema, rows: np.ndarray) -> np.ndarray:
        """Take in rows of the task (n,). Return, for each, whether the robot has fallen by then."""
        heights = schema.column(rows, "com")[:, 2].tolist()
        fallen = np.array(
            [
                has_fallen(q, com_height=height, standing_com_height=self._standing_com_height)
                for q, height in zip(schema.column(rows, "q"), heights, strict=True)
            ],
            dtype=bool,
        )
        if not len(rows):
            return fallen
        standing = np.flatnonzero(~fallen)
        if not fallen[-1]:
            self._fell_ns = None
        elif len(standing) or self._fell_ns is None:
            first = standing[-1] + 1 if len(standing) else 0
            self._fell_ns = int(schema.column(rows, "time_ns")[first])
        fell_ns = self._fell_ns
        self.text = STANDS if fell_ns is None else f"fell at {fell_ns * 1e-9:.2f} s"
        return fallen
