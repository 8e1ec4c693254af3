"""The on-board computer of a live run: a separate process beside the 1 kHz loop.

It is a process and not a thread: a QP is mostly Python and small matrices, which would hold the
interpreter while the control loop needs it. It is started before the loop. Jobs and answers go
through a pipe. It imitates a slow computer: a job lasts for its processor time times
`switch.compute_time_scale`.
"""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from robot_node.onboard import MakeSolve
from shared.config.settings import RunConfig
from shared.errors import LinkError

# The same as for a service, because the worker loads the same libraries.
_START_SECONDS = 60.0
# The priority is between those of shim and edge, because the work is the robot's but not in a tick.
_PRIORITY = 15


class WorkerComputer:
    """An `OnBoardComputer` in a process. Raises `LinkError` if it does not start."""

    def __init__(self, config: RunConfig, make_solve: MakeSolve) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, config, make_solve), daemon=True
        )
        self._process.start()
        theirs.close()
        if not self._pipe.poll(_START_SECONDS):
            raise LinkError(f"the on-board computer did not start within {_START_SECONDS:g} s")
        try:
            self._pipe.recv()
        except EOFError:
            raise LinkError("the on-board computer ended before it could be used") from None

    def start(self, q: np.ndarray, v: np.ndarray, *, now_ns: int, target: int) -> None:
        self._pipe.send((q, v, target))

    def finished(self, now_ns: int) -> bool:
        return self._pipe.poll()

    def take(self) -> Any:
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            return None

    def close(self) -> None:
        self._pipe.close()
        self._process.join(timeout=2.0)
        if self._process.is_alive():
            self._process.kill()


def _serve(pipe: Connection, config: RunConfig, make_solve: MakeSolve) -> None:
    """The worker: answers jobs until the pipe closes."""
    import signal

    from shared.clock import sleep_until
    from shared.motion.plan import make_motion
    from shared.process.realtime import prepare, suspend_garbage_collection
    from shared.robots import load_robot

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    robot = load_robot(config.robot.name)
    solve = make_solve(robot, config, make_motion(robot, config))
    prepare(priority=_PRIORITY)
    suspend_garbage_collection()
    pipe.send("ready")
    try:
        while True:
            q, v, target = pipe.recv()
            began_ns, used_ns = time.monotonic_ns(), time.thread_time_ns()
            solution = solve(q, v, target)
            used_ns = time.thread_time_ns() - used_ns
            sleep_until(began_ns + config.switch.ready_after_ns(used_ns))
            pipe.send(solution)
    except (EOFError, OSError):
        pass
