"""Printed output of a recording: its progress while it runs, and a summary."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from netem.profile import DIRECTIONS, LOST
from netem.recorder.record_loops import NearLoop
from netem.recorder.recording import Recorded


def say(line: str) -> None:
    """Print one line to standard output, and flush it."""
    print(line, flush=True)


def progress_in_words(loop: NearLoop) -> str:
    """Return the time left, and the delays and losses at present, as one line."""
    now = loop.near.progress
    return (
        f"{max(0.0, loop.left_seconds):5.1f} s left: up {now.uplink_ns * 1e-6:.2f} ms, "
        f"down {now.downlink_ns * 1e-6:.2f} ms, lost or late {now.uplink_lost} up, "
        f"{now.downlink_lost} down"
    )


def summary_lines(recorded: Recorded, path: Path) -> Iterator[str]:
    """The lines of the summary, in milliseconds."""
    profile = recorded.profile
    for name, delays_ns in zip(DIRECTIONS, profile.delays_ns, strict=True):
        passed_ms = delays_ns[delays_ns != LOST] * 1e-6
        p50, p99, longest = np.quantile(passed_ms, [0.5, 0.99, 1.0])
        lost = np.mean(delays_ns == LOST)
        yield (
            f"{name:>9}: p50 {p50:.3f} ms, p99 {p99:.3f} ms, longest {longest:.1f} ms, "
            f"lost {lost:.2%}"
        )
    yield f"   clocks: {_clock_in_words(recorded)}"
    n = profile.delays_ns.shape[1]
    held = ", ".join(f"{k} {way}" for k, way in zip(recorded.held, ("up", "down"), strict=True))
    yield (
        f"{path}: {profile.duration_ns * 1e-9:g} s, {n} periods of {profile.period_ns * 1e-6:g} "
        f"ms; periods without a message, which hold a neighbour's delay: {held}"
    )
    if any(recorded.impossible):
        yield (
            f"warning: by these clocks {sum(recorded.impossible)} messages arrived before they "
            "were sent; a clock was set or changed its rate during the recording"
        )


def _clock_in_words(recorded: Recorded) -> str:
    clock = recorded.clock
    if clock.uncertainty_ns is None:
        return f"{clock.method}: delays are as accurate as these clocks"
    if clock.uncertainty_ns == 0 and clock.offset_ns == 0:
        return f"{clock.method}: offset 0, delays are exact"
    return (
        f"far ahead by {clock.offset_ns * 1e-6:.3f} ms ± {clock.uncertainty_ns * 1e-6:.3f} ms, "
        f"drift {clock.drift_ppm:+.2f} ppm, from {clock.method}; if one way is slower, up to the "
        "uncertainty of its delay may be counted to the other way; a common clock is exact "
        "(--clock synchronised)"
    )
