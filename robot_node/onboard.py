"""The robot's own computer: full QPs around a contact switch (Sec. III-C), or factorisations.

For LA it works in a window centred on each planned switch. There it solves the QP of the present
contact mode every few milliseconds and, once, shortly before the switch, the QP of the coming mode.
For LC it factorises the present contact mode when corrections shrink the error too little. The
computer is slow: a solution is ready a while after the state it was computed from. Its answers
compete with the edge's in the cache, and the newer state wins.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from robot_node.cache import CacheEntry, FactorisationCache, ProjectorCache
from shared.config.control_settings import SwitchConfig
from shared.config.settings import RunConfig
from shared.errors import MessageRefused
from shared.robots import Robot
from shared.wbc.answer import Factorisation, TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Motion, coming_switches

if TYPE_CHECKING:
    from shared.wbc.whole_body import WholeBodyController

# The computation of an on-board computer at (q, v) for a target.
Solve = Callable[[np.ndarray, np.ndarray, int], Any]
# Makes the computation. A picklable function, because the computer may be a separate process.
MakeSolve = Callable[[Robot, RunConfig, Motion], Solve]


def projector_solve(robot: Robot, config: RunConfig, motion: Motion) -> Solve:
    """A projector for the contact mode of a task time [ns]."""
    controller = _whole_body_controller(robot, config, motion)

    def project(q: np.ndarray, v: np.ndarray, time_ns: int) -> TimedProjector | None:
        return controller.projector_for(q, v, time_ns=time_ns)

    return project


def factorisation_solve(robot: Robot, config: RunConfig, motion: Motion) -> Solve:
    """The factorisation of a contact mode, by its number."""
    controller = _whole_body_controller(robot, config, motion)

    def factorise(q: np.ndarray, v: np.ndarray, mode: int) -> tuple[Factorisation, ...] | None:
        return controller.factorise(q, (ContactMode(mode),), damping=config.correction.damping)

    return factorise


def _whole_body_controller(robot: Robot, config: RunConfig, motion: Motion) -> WholeBodyController:
    # A robot that does not solve loads neither the solvers nor SciPy.
    from shared.wbc.whole_body import WholeBodyController

    return WholeBodyController(robot, config, motion)


class OnBoardComputer(Protocol):
    """Solves one problem at a time, beside the control loop."""

    def start(self, q: np.ndarray, v: np.ndarray, *, now_ns: int, target: int) -> None:
        """Begin at task time `now_ns` to solve at (q, v) for a `target`, see `Solve`."""
        ...

    def finished(self, now_ns: int) -> bool:
        """Return whether the solution begun last is ready."""
        ...

    def take(self) -> Any:
        """Return that solution, or None if there is none."""
        ...

    def close(self) -> None:
        """End the computer."""
        ...


# Starts a computer for a problem.
StartComputer = Callable[[MakeSolve], OnBoardComputer]


class ModelledComputer:
    """Solves at once, and releases the solution `ready_after_ns` of task time later: repeatable."""

    def __init__(self, solve: Solve, *, ready_after_ns: int) -> None:
        self._solve = solve
        self._ready_after_ns = ready_after_ns
        self._ready_ns = 0
        self._solution: Any = None

    def start(self, q: np.ndarray, v: np.ndarray, *, now_ns: int, target: int) -> None:
        self._ready_ns = now_ns + self._ready_after_ns
        self._solution = self._solve(q, v, target)

    def finished(self, now_ns: int) -> bool:
        return now_ns >= self._ready_ns

    def take(self) -> Any:
        return self._solution

    def close(self) -> None:
        pass


class OnBoard(Protocol):
    """Schedule of the robot's own computer. It puts the answers into the cache."""

    @property
    def solves(self) -> int:
        """The number of problems begun so far."""
        ...

    def tick(
        self, q: np.ndarray, v: np.ndarray, *, time_ns: int, sequence: int, stamp_ns: int
    ) -> None:
        """Put ready answers into the cache. Start the problem that is due from the state (q, v)."""
        ...

    def close(self) -> None:
        """End the computer."""
        ...


class OnBoardWindow:
    """Decide when to solve which QP, and put the projector into the cache when it is ready."""

    def __init__(
        self,
        config: SwitchConfig,
        motion: Motion,
        computer: OnBoardComputer,
        cache: ProjectorCache,
    ) -> None:
        self.solves = 0
        self._cache = cache
        self._config = config
        self._motion = motion
        self._computer = computer
        self._ready_after_ns = config.ready_after_ns(config.compute_ns)
        # A preparation must be ready at the switch, also on a slow computer.
        self._prepare_ns = max(config.prepare_ns, self._ready_after_ns)
        self._period_ns = max(config.period_ns, self._ready_after_ns)
        self._under_way: tuple[int, int] | None = None
        self._next_solve_ns = self._idle_until_ns = 0
        self._last_switch_ns = -(2**62)
        self._prepared_for_ns = -1

    def tick(
        self, q: np.ndarray, v: np.ndarray, *, time_ns: int, sequence: int, stamp_ns: int
    ) -> None:
        self._finish(time_ns)
        if self._under_way is None and (for_ns := self._due(time_ns)) is not None:
            self._computer.start(q, v, now_ns=time_ns, target=for_ns)
            self._under_way = (sequence, stamp_ns)
            self.solves += 1
            self._finish(time_ns)

    def close(self) -> None:
        self._computer.close()

    def _finish(self, time_ns: int) -> None:
        if self._under_way is None or not self._computer.finished(time_ns):
            return
        sequence, stamp_ns = self._under_way
        self._under_way = None
        timed = self._computer.take()
        if timed is not None:
            self._cache.keep(CacheEntry(timed, sequence, stamp_ns, on_board=True, proven=True))

    def _due(self, time_ns: int) -> int | None:
        """Return the task time to solve for now: a coming switch, the present, or None."""
        if time_ns < self._idle_until_ns:
            return None
        config = self._config
        switches = coming_switches(self._motion, time_ns)
        free_until_ns = 2**62
        if config.prepare_on_board and (preparation := self._next_preparation(switches)):
            switch_ns, free_until_ns = preparation
            if time_ns >= free_until_ns:
                self._prepared_for_ns = switch_ns
                return switch_ns
        if not config.solve_on_board or not self._in_window(time_ns, switches):
            window_ns = switches[0] - config.window_ns // 2 if switches else 2**62
            self._idle_until_ns = min(free_until_ns, window_ns)
            return None
        if time_ns < self._next_solve_ns or time_ns + self._ready_after_ns > free_until_ns:
            return None
        self._next_solve_ns = time_ns + self._period_ns
        return time_ns

    def _next_preparation(self, switches: list[int]) -> tuple[int, int] | None:
        """Return the first switch that is not prepared, and when to begin with it.

        Preparations run one after the other, each ready in time. If two switches are closer than
        one preparation takes, the first preparation begins earlier.
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


class OnBoardRefresh:
    """Factorise on board when corrections shrink the error too little, within a budget of time.

    `wanted` gives the contact mode for which a new factorisation would help, or None.
    """

    def __init__(
        self,
        config: RunConfig,
        computer: OnBoardComputer,
        cache: FactorisationCache,
        wanted: Callable[[], ContactMode | None],
    ) -> None:
        self.solves = 0
        self._computer = computer
        self._cache = cache
        self._wanted = wanted
        ready_after_ns = config.switch.ready_after_ns(config.switch.compute_ns)
        self._pause_ns = ready_after_ns / config.correction.on_board_budget
        self._under_way: tuple[int, int] | None = None
        self._next_start_ns = 0.0

    def tick(
        self, q: np.ndarray, v: np.ndarray, *, time_ns: int, sequence: int, stamp_ns: int
    ) -> None:
        if self._under_way is not None and self._computer.finished(time_ns):
            started, stamp = self._under_way
            self._under_way = None
            factorisations = self._computer.take()
            if factorisations is not None:
                self._keep(factorisations, started, stamp)
        if self._under_way is not None or time_ns < self._next_start_ns:
            return
        mode = self._wanted()
        if mode is not None:
            self._computer.start(q, v, now_ns=time_ns, target=mode)
            self._under_way = (sequence, stamp_ns)
            self._next_start_ns = time_ns + self._pause_ns
            self.solves += 1

    def close(self) -> None:
        self._computer.close()

    def _keep(
        self, factorisations: tuple[Factorisation, ...], sequence: int, stamp_ns: int
    ) -> None:
        # An unusable factorisation counts as none.
        with contextlib.suppress(MessageRefused):
            self._cache.keep(factorisations, sequence=sequence, stamp_ns=stamp_ns, on_board=True)
