"""Make the calling process fit for a periodic loop, as far as the system permits."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time

_PR_SET_TIMERSLACK = 29


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
