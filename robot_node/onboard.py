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
from shared.motion.reference import Motion, coming_switches
from shared.wbc.whole_body import TimedProjector, WholeBodyController


class OnBoardComputer(Protocol):
    """Solves one QP at a time, beside the control loop."""

    def start(self, q: np.ndarray, v: np.ndarray, *, now_ns: int, for_ns: int) -> None:
        """Begin at task time `now_ns` to solve at (q, v) for the contact mode of `for_ns`."""
        ...

    def finished(self, now_ns: int) -> bool:
        """Whether the solution begun last is ready."""
        ...

    def take(self) -> TimedProjector | None:
        """That solution; None if the QP had none."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class ModelledComputer:
    """Solves at once and calls it ready `ready_after_ns` of task time later: repeatable."""

    def __init__(self, controller: WholeBodyController, *, ready_after_ns: int) -> None:
        self._controller = controller
        self._ready_after_ns = ready_after_ns
        self._ready_ns = 0
        self._solution: TimedProjector | None = None

    def start(self, q: np.ndarray, v: np.ndarray, *, now_ns: int, for_ns: int) -> None:
        self._ready_ns = now_ns + self._ready_after_ns
        self._solution = self._controller.projector_for(q, v, time_ns=for_ns)

    def finished(self, now_ns: int) -> bool:
        return now_ns >= self._ready_ns

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
        self._ready_after_ns = config.ready_after_ns(config.compute_ns)
        # A preparation must be ready at the switch, however slow the computer.
        self._prepare_ns = max(config.prepare_ns, self._ready_after_ns)
        self._period_ns = max(config.period_ns, self._ready_after_ns)
        self._under_way: tuple[int, int] | None = None
        self._next_solve_ns = 0
        self._last_switch_ns = -(2**62)
        self._prepared_for_ns = -1

    def tick(
        self, q: np.ndarray, v: np.ndarray, *, time_ns: int, sequence: int, stamp_ns: int
    ) -> CacheEntry | None:
        """Start what is due at a task time from the state (q, v); return what has become ready."""
        entry = self._finished(time_ns)
        if self._under_way is None and (for_ns := self._due(time_ns)) is not None:
            self._computer.start(q, v, now_ns=time_ns, for_ns=for_ns)
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

    def _due(self, time_ns: int) -> int | None:
        """The task time to solve for now: a coming switch, this moment, or None."""
        config = self._config
        switches = coming_switches(self._motion, time_ns)
        free_until_ns = 2**62
        if config.prepare_on_board and (preparation := self._next_preparation(switches)):
            switch_ns, free_until_ns = preparation
            if time_ns >= free_until_ns:
                self._prepared_for_ns = switch_ns
                return switch_ns
        if not config.solve_on_board or not self._in_window(time_ns, switches):
            return None
        if time_ns < self._next_solve_ns or time_ns + self._ready_after_ns > free_until_ns:
            return None
        self._next_solve_ns = time_ns + self._period_ns
        return time_ns

    def _next_preparation(self, switches: list[int]) -> tuple[int, int] | None:
        """The first switch that is not prepared, and when to begin with it.

        One after the other, each ready in time: two switches that follow each other sooner than one
        preparation takes make the first begin earlier.
        """
        waiting = [switch_ns for switch_ns in switches if switch_ns > self._prepared_for_ns]
        begin_ns = 2**62
        for switch_ns in reversed(waiting):
            begin_ns = min(switch_ns - self._prepare_ns, begin_ns - self._ready_after_ns)
        return (waiting[0], begin_ns) if waiting else None

    def _in_window(self, time_ns: int, switches: list[int]) -> bool:
        half_ns = self._config.window_ns // 2
        if switches and switches[0] - time_ns <= half_ns:
            self._last_switch_ns = switches[0]
            return True
        return 0 <= time_ns - self._last_switch_ns <= half_ns
