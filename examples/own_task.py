"""Your own task: Romeo bends its knees, with answers that are 60 ms old.

    ./deploy/python -m examples.own_task

A task is a motion: the reference of CoM, trunk, posture and feet at every time. Each end of the
link computes it, see `shared.wbc.reference.Motion`.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.motion.standing import Standing
from shared.robots import Robot
from shared.wbc.reference import Reference, motion_digest

DEPTH, PERIOD = 0.06, 2.0  # m, s


class KneeBends(Standing):
    """The CoM goes down by DEPTH and up again every PERIOD; all else is as in standing."""

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        super().__init__(robot)
        # In every message, so that two ends with different motions refuse each other.
        self.digest = motion_digest(np.array([DEPTH, PERIOD]), np.frombuffer(self.digest, np.uint8))

    def reference(self, time_ns: int) -> Reference:
        """Add −DEPTH (1 − cos ωt) / 2 and its derivatives to the CoM of standing."""
        standing, rate = super().reference(time_ns), 2.0 * math.pi / PERIOD
        angle, up = rate * time_ns * 1e-9, np.array([0.0, 0.0, 1.0])
        return dataclasses.replace(
            standing,
            com=standing.com - 0.5 * DEPTH * (1.0 - math.cos(angle)) * up,
            com_velocity=-0.5 * DEPTH * rate * math.sin(angle) * up,
            com_acceleration=-0.5 * DEPTH * rate**2 * math.cos(angle) * up,
        )


def main(duration: float = 4.0) -> TrialResult:
    """Play two knee bends; print the reference and the measured height of the CoM."""
    settings = {"duration": duration, "push": [], "link.network": "constant:60ms"}
    settings["wbc.weights.posture"] = 1e-4  # lower, so that the posture gives way
    result = Lockstep(load_config(None, settings), make_motion=KneeBends).run()
    asked, was = (result.schema.column(result.rows, key) for key in ("com_reference", "com"))
    print("  time   CoM height: reference, reached [m]")
    for tick in range(0, len(result.rows), 500):
        print(f"{tick / 1000:5.2f} s {asked[tick, 2]:9.3f} {was[tick, 2]:9.3f}")
    print("falls" if result.summary["fell"] else "stands")
    return result


if __name__ == "__main__":
    main()
