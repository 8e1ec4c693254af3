"""Make the calling process fit for a periodic loop, as far as the system permits."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

_PR_SET_TIMERSLACK = 29
_RUNTIME, _PERIOD = (Path(f"/proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period"))


# Above ordinary programs, and below every service.
LOWEST_PRIORITY = 1


def prepare(*, priority: int) -> str:
    """Ask for precise timers and real-time scheduling. Return the scheduling in words.

    Real-time scheduling is SCHED_FIFO at `priority`; without permission the process keeps ordinary
    scheduling. Call this before a bus is opened, so that the bus's threads inherit both. Memory is
    not locked: with locked memory every allocation faulted its pages in at once, which cost more
    than it saved (`docs/timing.md`).
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError):
        return "ordinary scheduling (real-time needs root or an rtprio limit)"
    return f"SCHED_FIFO {priority}"


@contextlib.contextmanager
def just_above_ordinary() -> Iterator[None]:
    """Give threads that start in this context the lowest real-time priority, if it is permitted.

    It is below that of every service, and above all ordinary programs. It is for threads that use
    little time, and that an operator waits for.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LOWEST_PRIORITY))
    except (OSError, AttributeError):
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


class RealtimeBudget:
    """Keeps a loop below the share of a core at which Linux stops real-time threads.

    A real-time thread that has used 0.95 s of a second (`sched_rt_runtime_us`) stands still for the
    other 50 ms. A loop that calls `keep` in every turn pauses instead for a millisecond or two in
    every 20 ms, and only if it would otherwise use its core without pause.
    """

    WINDOW_NS = 20_000_000
    # A part of the kernel's share, because other real-time threads of the process run on the core
    # too.
    _MARGIN = 0.98

    def __init__(self) -> None:
        limit = realtime_share()
        self._share = self._MARGIN * limit if limit < 1.0 else math.inf
        self._began_ns, self._used_ns = time.monotonic_ns(), time.thread_time_ns()

    def keep(self, now_ns: int) -> None:
        """Sleep if this thread has used more than its share since the window began."""
        if now_ns - self._began_ns < self.WINDOW_NS:
            return
        used_ns = time.thread_time_ns()
        over_ns = (used_ns - self._used_ns) / self._share - (now_ns - self._began_ns)
        if over_ns > 0:
            time.sleep(over_ns * 1e-9)
            now_ns = time.monotonic_ns()
        self._began_ns, self._used_ns = now_ns, used_ns


class RealtimeShare:
    """Gives a loop real-time priority for a share of a core, and ordinary scheduling beyond it.

    A loop that calls `keep` in every turn has at least its `share` beside any number of ordinary
    processes. When it has used the share in a window, it competes with them until the window ends.
    Without real-time scheduling this does nothing.
    """

    WINDOW_NS = 20_000_000

    def __init__(self, share: float) -> None:
        self._share_ns = share * self.WINDOW_NS
        self._realtime = _scheduling()
        self._beyond = False
        self._began_ns, self._used_ns = time.monotonic_ns(), time.thread_time_ns()

    def keep(self, now_ns: int) -> None:
        """Change this thread's scheduling if a window has ended, or its share is used."""
        if self._realtime is None:
            return
        used_ns = time.thread_time_ns()
        if now_ns - self._began_ns >= self.WINDOW_NS:
            self._began_ns, self._used_ns = now_ns, used_ns
            if self._beyond:
                os.sched_setscheduler(0, *self._realtime)
                self._beyond = False
        elif not self._beyond and used_ns - self._used_ns > self._share_ns:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            self._beyond = True


def _scheduling() -> tuple[int, os.sched_param] | None:
    """Return this thread's real-time scheduling; None if it has none."""
    try:
        policy = os.sched_getscheduler(0)
        return (policy, os.sched_getparam(0)) if policy == os.SCHED_FIFO else None
    except (OSError, AttributeError):
        return None


def realtime_share() -> float:
    """Return the share of a core that Linux leaves to this thread if it never sleeps.

    It is 1 under ordinary scheduling, without the kernel's limit, and on other systems.
    """
    try:
        if os.sched_getscheduler(0) != os.SCHED_FIFO:
            return 1.0
        runtime_us, period_us = (int(each.read_text()) for each in (_RUNTIME, _PERIOD))
    except (OSError, AttributeError, ValueError):
        return 1.0
    return 1.0 if runtime_us < 0 else runtime_us / period_us


def usable_cores() -> int:
    """Return the number of cores that this process may run on."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def wakes_late_ns(*, sleeps: int = 50, sleep_ns: int = 500_000) -> int:
    """Measure how late a sleeping thread of this process wakes: the 90th percentile [ns]."""
    late = []
    for _ in range(sleeps):
        due_ns = time.monotonic_ns() + sleep_ns
        time.sleep(sleep_ns * 1e-9)
        late.append(time.monotonic_ns() - due_ns)
    return sorted(late)[9 * sleeps // 10]


def suspend_garbage_collection() -> None:
    """Switch off the garbage collector, so that it pauses no loop. Loops allocate no cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()
