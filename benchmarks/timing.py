"""Timing of one call after another on one pinned core, and the table that shows it."""

from __future__ import annotations

import gc
import itertools
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from shared.output.versions import cpu_name, versions

_WARM_UP = 50

Sample = TypeVar("Sample")


@dataclass(frozen=True)
class Timing:
    """Duration of one operation in milliseconds."""

    name: str
    p50_ms: float
    p99_ms: float

    @staticmethod
    def of(name: str, durations_ns: np.ndarray) -> Timing:
        """Quantiles of measured durations."""
        p50, p99 = np.percentile(durations_ns, [50, 99]) * 1e-6
        return Timing(name, float(p50), float(p99))


@dataclass(frozen=True)
class Ratio:
    """Ratio of the durations of two operations, both measured in alternating batches.

    `p50` is the median, over the rounds, of the ratio of the two batches' medians; `least` and
    `most` are its extremes. `p99` is the ratio of the 99th percentiles of all durations.
    """

    p50: float
    least: float
    most: float
    p99: float

    @staticmethod
    def of(ours: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> Ratio:
        """Compute the ratio from the durations in the batches of the same rounds."""
        by_round = [
            np.median(one) / np.median(other) for one, other in zip(ours, others, strict=True)
        ]
        ours_p99, others_p99 = (np.percentile(np.concatenate(each), 99) for each in (ours, others))
        return Ratio(
            p50=float(np.median(by_round)),
            least=float(min(by_round)),
            most=float(max(by_round)),
            p99=float(ours_p99 / others_p99),
        )

    @property
    def p50_text(self) -> str:
        """Text of `p50` and its extremes: `0.62 (0.60–0.65)`."""
        return f"{self.p50:.2f} ({self.least:.2f}–{self.most:.2f})"


def pin_to_one_core() -> str:
    """Keep this process on one core. Return a text that names the core."""
    try:
        core = max(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {core})
    except (AttributeError, OSError):
        return "not pinned (the system does not allow it)"
    return f"pinned to core {core}"


def machine() -> str:
    """CPU name and the other load of the machine. Distrust numbers from a busy machine."""
    load = f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"
    return f"{cpu_name()}, {os.cpu_count()} cores, load average {load}"


def cores_busy(*, seconds: float) -> float:
    """Share of all cores that was busy during `seconds`, 0 to 1; NaN if the system does not say."""
    first = _processor_times()
    time.sleep(seconds)
    total, idle = (_processor_times() - first).T
    return float(1.0 - idle / total) if total > 0 else math.nan


def _processor_times() -> np.ndarray:
    """Total and idle time of all cores since the start, in the system's ticks."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return np.zeros(2)
    words = stat.read_text(encoding="utf-8").splitlines()[0].split()[1:9]
    times = np.array([int(word) for word in words])
    # Fields 4 and 5 of proc_stat(5): idle, and idle waiting for a disk.
    return np.array([times.sum(), times[3:5].sum()])


def measure(
    name: str,
    operation: Callable[[Sample], object],
    samples: Sequence[Sample],
    *,
    repetitions: int,
) -> Timing:
    """Time `operation` on the samples in turn."""
    supply = itertools.cycle(samples)
    for _ in range(_WARM_UP):
        operation(next(supply))
    durations = np.empty(repetitions)
    gc.disable()
    for k in range(repetitions):
        sample = next(supply)
        start = time.perf_counter_ns()
        operation(sample)
        durations[k] = time.perf_counter_ns() - start
    gc.enable()
    return Timing.of(name, durations)


def table(timings: Sequence[Timing], *, reference: str) -> str:
    """Aligned text: name, p50, p99, and p50 as a ratio of the reference operation's p50."""
    base = next(timing.p50_ms for timing in timings if timing.name == reference)
    width = max(len(timing.name) for timing in timings)
    lines = [f"{'':{width}}  p50 [ms]  p99 [ms]  p50 / ({reference})"]
    lines += [
        f"{timing.name:{width}}  {timing.p50_ms:8.4f}  {timing.p99_ms:8.4f}  "
        f"{timing.p50_ms / base:8.3f}"
        for timing in timings
    ]
    return "\n".join(lines)


def packages() -> str:
    """Return the versions that numbers depend on, as a line of text."""
    return ", ".join(f"{name} {version}" for name, version in versions().items())


def header() -> str:
    """Machine and versions, as a header above the numbers of one pinned process."""
    return f"{machine()}; {pin_to_one_core()}; one BLAS thread\n{packages()}"


def header_of_processes(busy: float, *more: str) -> str:
    """Machine, its load before the start (`cores_busy`) and versions, above numbers of processes.

    `more` stands after the load.
    """
    load = f"{machine()}, {busy:.0%} of the cores busy before the start"
    return "; ".join([load, *more]) + f"\n{packages()}"
