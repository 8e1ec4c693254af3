"""The on-board computer of a live run: a process of its own beside the 1 kHz loop.

A process and not a thread: a QP is mostly Python and small matrices, which would hold the
interpreter while the control loop needs it. It is started before the loop; jobs and answers go
through a pipe. An answer comes no sooner than `compute_ns` after its job: a slow computer.
"""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.connection import Connection

import numpy as np

from robot_node.onboard import solve_job
from shared.config import RunConfig
from shared.errors import LinkError
from shared.wbc.whole_body import TimedProjector

_START_SECONDS = 30.0


class WorkerComputer:
    """An `OnBoardComputer` in a process. `LinkError` if it does not start."""

    def __init__(self, config: RunConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, config), daemon=True)
        self._process.start()
        theirs.close()
        if not self._pipe.poll(_START_SECONDS):
            raise LinkError(f"the on-board computer did not start within {_START_SECONDS:g} s")
        self._pipe.recv()

    def start(self, q: np.ndarray, v: np.ndarray, *, time_ns: int, prepare: bool) -> None:
        self._pipe.send((q, v, time_ns, prepare))

    def finished(self, time_ns: int) -> bool:
        return self._pipe.poll()

    def take(self) -> TimedProjector | None:
        try:
            solution: TimedProjector | None = self._pipe.recv()
        except (EOFError, OSError):
            return None
        return solution

    def close(self) -> None:
        self._pipe.close()
        self._process.join(timeout=2.0)
        if self._process.is_alive():
            self._process.kill()


def _serve(pipe: Connection, config: RunConfig) -> None:
    """The worker: answers jobs until the pipe closes."""
    import signal

    from shared.motion.plan import make_motion
    from shared.robots import load_robot
    from shared.wbc.whole_body import WholeBodyController

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    robot = load_robot(config.robot.name)
    motion = make_motion(robot, config)
    controller = WholeBodyController(robot, config.wbc, motion)
    pipe.send("ready")
    try:
        while True:
            q, v, time_ns, prepare = pipe.recv()
            due = time.monotonic() + config.switch.compute_ns * 1e-9
            solution = solve_job(controller, motion, q, v, time_ns=time_ns, prepare=prepare)
            time.sleep(max(0.0, due - time.monotonic()))
            pipe.send(solution)
    except (EOFError, OSError):
        pass
