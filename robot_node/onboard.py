"""The robot's own full QPs around a contact switch, Sec. III-C.

In a window centred on each planned switch the on-board computer solves the QP of the present
contact mode every few milliseconds, and once, shortly before the switch, that of the next one. It
is slow: a solution is ready a while after the state it was computed from. Its answers compete with
the edge's in the cache, and the newer state wins.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from robot_node.cache import CacheEntry
from shared.config import SwitchConfig
from shared.motion.reference import Motion
from shared.wbc.whole_body import TimedProjector, WholeBodyController


class OnBoardComputer(Protocol):
    """Solves one QP at a time, beside the control loop."""

    def start(self, q: np.ndarray, v: np.ndarray, *, time_ns: int, prepare: bool) -> None:
        """Begin to solve for the mode of `time_ns`, or with `prepare` for the next one."""
        ...

    def finished(self, time_ns: int) -> bool:
        """Whether the solution begun last is ready at a task time."""
        ...

    def take(self) -> TimedProjector | None:
        """That solution; None if the QP had none."""
        ...

    def close(self) -> None:
        """End it."""
        ...


def solve_job(
    controller: WholeBodyController,
    motion: Motion,
    q: np.ndarray,
    v: np.ndarray,
    *,
    time_ns: int,
    prepare: bool,
) -> TimedProjector | None:
    """What an on-board computer computes, wherever it runs."""
    if prepare:
        return controller.prepare(q, v, time_ns=time_ns)
    mode = motion.reference(time_ns).mode
    solution, _ = controller.solve(q, v, time_ns=time_ns, mode=mode)
    if solution.projector is None:
        return None
    return controller.timed(solution.projector, from_ns=time_ns)


class ModelledComputer:
    """Solves at once and hands the solution over `compute_ns` of task time later: repeatable."""

    def __init__(self, controller: WholeBodyController, motion: Motion, *, compute_ns: int) -> None:
        self._controller = controller
        self._motion = motion
        self._compute_ns = compute_ns
        self._ready_ns = 0
        self._solution: TimedProjector | None = None

    def start(self, q: np.ndarray, v: np.ndarray, *, time_ns: int, prepare: bool) -> None:
        self._ready_ns = time_ns + self._compute_ns
        self._solution = solve_job(
            self._controller, self._motion, q, v, time_ns=time_ns, prepare=prepare
        )

    def finished(self, time_ns: int) -> bool:
        return time_ns >= self._ready_ns

    def take(self) -> TimedProjector | None:
        return self._solution

    def close(self) -> None:
        pass


class OnBoardWindow:
    """Decides what to solve when, and hands it over when it is ready."""

    def __init__(self, config: SwitchConfig, motion: Motion, computer: OnBoardComputer) -> None:
        self.solves = 0
        self._config = config
        self._motion = motion
        self._computer = computer
        # A preparation must be ready at the switch, however slow the computer.
        self._prepare_ns = max(config.prepare_ns, config.compute_ns)
        self._period_ns = max(config.period_ns, config.compute_ns)
        self._under_way: tuple[int, int] | None = None
        self._next_solve_ns = 0
        self._last_switch_ns = -(2**62)
        self._prepared_for_ns = -1

    def tick(
        self, q: np.ndarray, v: np.ndarray, *, time_ns: int, sequence: int, stamp_ns: int
    ) -> CacheEntry | None:
        """Start what is due at a task time from the state (q, v); return what has become ready."""
        entry = self._finished(time_ns)
        if self._under_way is None and (due := self._due(time_ns)) is not None:
            self._computer.start(q, v, time_ns=time_ns, prepare=due == "prepare")
            self._under_way = (sequence, stamp_ns)
            self.solves += 1
            entry = self._finished(time_ns) or entry
        return entry

    def close(self) -> None:
        """End the computer."""
        self._computer.close()

    def _finished(self, time_ns: int) -> CacheEntry | None:
        if self._under_way is None or not self._computer.finished(time_ns):
            return None
        sequence, stamp_ns = self._under_way
        self._under_way = None
        timed = self._computer.take()
        return None if timed is None else CacheEntry(timed, sequence, stamp_ns, on_board=True)

    def _due(self, time_ns: int) -> str | None:
        """`prepare`, `solve` or None."""
        config = self._config
        switch = self._motion.next_switch(time_ns)
        until_ns = 2**62 if switch is None else switch[0] - time_ns
        in_window = self._in_window(time_ns, until_ns)
        preparing = config.prepare_on_board and until_ns <= self._prepare_ns
        if preparing and switch is not None and self._prepared_for_ns != switch[0]:
            self._prepared_for_ns = switch[0]
            return "prepare"
        if config.solve_on_board and in_window and time_ns >= self._next_solve_ns:
            self._next_solve_ns = time_ns + self._period_ns
            return "solve"
        return None

    def _in_window(self, time_ns: int, until_ns: int) -> bool:
        half_ns = self._config.window_ns // 2
        if until_ns <= half_ns:
            self._last_switch_ns = time_ns + until_ns
            return True
        return 0 <= time_ns - self._last_switch_ns <= half_ns
