"""Make the calling process fit for a periodic loop, as far as the system permits."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time

_PR_SET_TIMERSLACK = 29


def prepare(*, priority: int) -> str:
    """Precise timers and real-time scheduling (SCHED_FIFO at `priority`); returns what was got.

    Called before a bus is opened, so that the bus's own threads inherit both. Without permission
    the process runs as any other, and says so. Memory is not locked: that made every allocation
    fault its pages in at once and cost more than it saved (`docs/timing.md`).
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError):
        return "ordinary scheduling (real-time needs root or an rtprio limit)"
    return f"SCHED_FIFO {priority}"


def usable_cores() -> int:
    """How many cores this process may run on."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def wakes_late_ns(*, sleeps: int = 50, sleep_ns: int = 500_000) -> int:
    """How late a sleeping thread of this process wakes here [ns]: nine of ten times no later."""
    late = []
    for _ in range(sleeps):
        due_ns = time.monotonic_ns() + sleep_ns
        time.sleep(sleep_ns * 1e-9)
        late.append(time.monotonic_ns() - due_ns)
    return sorted(late)[9 * sleeps // 10]


def suspend_garbage_collection() -> None:
    """No collector pauses from here on: loops allocate no cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()
