"""Your own controller: the edge's last solution with the robot's present dynamics.

    ./deploy/python -m examples.own_controller

PR applies the edge's last torque, LA its last projector. This controller lies between them: it
keeps the last *solution* y = (a, f), and recovers the torque with the dynamics of the present
state. A controller is two methods and a cache, see `robot_node.controllers.Controller`. The robot
keeps its sensors, its checks of messages, the clamp of torques and telemetry.
"""

from __future__ import annotations

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from robot_node.cache import ProjectorCache
from robot_node.controllers import Controller, ControllerParts, Decision
from shared.config.config_file import load_config
from shared.telemetry.schema import Source
from shared.wbc.reference import Reference
from shared.wbc.torque import recover_torque


class LastSolution(Controller):
    """τ = S (M a + h − J_cᵀ G f), with y = (a, f) from the edge and all else measured now."""

    def __init__(self, parts: ControllerParts) -> None:
        self.cache: ProjectorCache = ProjectorCache(parts.codec, session=parts.session)
        self._parts = parts
        self._state: tuple[np.ndarray, np.ndarray]

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        self._state = q, v

    def command(self, *, time_ns: int) -> Decision | None:
        answer = self.cache.newest_solution
        if answer is None or answer.y is None:
            return None  # the robot then holds its joints
        mode, active_set = answer.projector.mode, answer.projector.active_set
        contacts = self._parts.stacks[mode].contacts
        tau = recover_torque(self._parts.model, contacts, *self._state, answer.y)
        source = Source.CACHED  # the source unless the answer is for this state
        return Decision(tau, answer.y, mode, active_set, source, answer.sequence, answer.stamp_ns)


def main(duration: float = 3.0) -> tuple[TrialResult, TrialResult]:
    """Push the robot while every answer is 50 ms old, with PR and with this controller."""
    settings = {"controller": "pr", "duration": duration, "link.network": "constant:50ms"}
    config = load_config(None, settings)
    pr, mine = Lockstep(config).run(), Lockstep(config, make_controller=LastSolution).run()
    for name, summary in (("PR", pr.summary), ("the last solution", mine.summary)):
        outcome = "falls" if summary["fell"] else "stands"
        print(f"on {name} Romeo {outcome} after {summary['task_seconds']:.2f} s")
    return pr, mine


if __name__ == "__main__":
    main()
