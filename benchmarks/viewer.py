"""Effect of a viewer on the robot: ticks of live runs with a good viewer, a bad one and none.

The same balance runs over the same link, again and again. In one case there is no viewer, and in
one the view is recorded and served to a browser. In the others the viewer runs only now and then,
is stopped for good, or is killed. The robot's ticks come from its telemetry: the computing time of
a tick, how late it begins, and the number of overruns. No browser or window is opened: its load
belongs to its own machine.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.live_stack import LiveStack, ended_within, live_stack
from benchmarks.timing import cores_busy, header_of_processes
from deploy.background.state import READY
from deploy.services import VIEWER
from shared.errors import ConfigError, LinkError
from shared.output.text_table import aligned
from shared.telemetry.metrics import in_task
from shared.telemetry.parquet import read_parquet

_NETWORK = "constant:20ms"
# After everything is ready [s]: by then the robot has begun.
_UNDISTURBED = 2.0
# Ticks of the first second are left out: code takes longer at its first use [ns].
_WARM_UP_NS = 1_000_000_000
# Besides what the run lasts: starting, writing files, and ending a viewer that does not answer.
_MORE_SECONDS = 240.0
_FOR_EVER = 1e6


@dataclass(frozen=True)
class Case:
    """A way to watch: the `view` of `./deploy/up`, and the signals to its viewer.

    The signals begin once the viewer has run for a while. They come in turn and over again, each
    with the time until the next [s].
    """

    name: str
    view: str
    signals: tuple[tuple[signal.Signals, float], ...] = ()


NOT_WATCHED = Case("no viewer", "off")
CASES = (
    NOT_WATCHED,
    Case("recorded and served", "web"),
    Case("slow: runs 10 % of the time", "web", ((signal.SIGSTOP, 0.45), (signal.SIGCONT, 0.05))),
    Case("stopped after 2 s", "web", ((signal.SIGSTOP, _FOR_EVER),)),
    Case("killed after 2 s", "web", ((signal.SIGKILL, _FOR_EVER),)),
)


@dataclass(frozen=True)
class Ticks:
    """The ticks of one run: quantiles of the computing time and of the late beginning [ms]."""

    p50: float
    p99: float
    maximum: float
    late_p99: float
    overruns: int


def run(*, seconds: float, repetitions: int) -> str:
    """Play every case `repetitions` times for `seconds`, in turn. Return the table as text."""
    busy = cores_busy(seconds=2.0)
    played: dict[Case, list[Ticks]] = {case: [] for case in CASES}
    for _ in range(repetitions):
        for case in CASES:
            played[case].append(play(case, seconds=seconds))
    return "\n".join(
        [
            header_of_processes(busy),
            f"balance with LA over {_NETWORK}, {seconds:g} s without the first; median of "
            f"{repetitions} (least–most), ratio to the run without a viewer of the same round",
            "",
            *_table(played),
        ]
    )


def play(case: Case, *, seconds: float) -> Ticks:
    """Play a run of the live stack.

    Raise `LinkError` if it does not come to its end with a robot that stands, or has no viewer to
    disturb.
    """
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name:
        folder = Path(name)
        how = ["--network", _NETWORK, "--controller", "la", "--push", "none"]
        how += ["--duration", f"{seconds:g}", "--view", case.view]
        with live_stack(folder, *how) as stack:
            if case.signals:
                group = _viewer(stack)
                time.sleep(_UNDISTURBED)
                disturb(stack.up, group, case.signals, seconds=seconds + _MORE_SECONDS)
            code = ended_within(stack.up, seconds + _MORE_SECONDS)
        if code is None:
            raise LinkError(f"{case.name}: the run did not end within {_MORE_SECONDS:g} s more")
        if code != 0:
            raise LinkError(f"{case.name}: the run ended with {code}; it said: {stack.last_line()}")
        return read_ticks(folder / "run" / "telemetry.parquet")


def disturb(
    up: subprocess.Popen[bytes],
    group: int,
    signals: Sequence[tuple[signal.Signals, float]],
    *,
    seconds: float,
) -> None:
    """Send a group of processes signals in turn until `up` has ended, for at most `seconds`."""
    deadline = time.monotonic() + seconds
    for number, pause in itertools.cycle(signals):
        left = deadline - time.monotonic()
        if left <= 0.0:
            return
        try:
            os.killpg(group, number)
        except ProcessLookupError:
            return  # The run is over, and has ended its viewer.
        if ended_within(up, min(pause, left)) is not None:
            return


def read_ticks(file: Path) -> Ticks:
    """Read the ticks of a run's telemetry, without its first second.

    Raise `ConfigError` if the run does not last more than a second.
    """
    schema, rows = read_parquet(file, columns=("time_ns", "tick_ns", "late_ns", "overruns"))
    rows = in_task(schema, rows)
    first = rows[schema.column(rows, "time_ns") < _WARM_UP_NS]
    rows = rows[len(first) :]
    if not len(first) or not len(rows):
        raise ConfigError(f"{file}: expected a run of more than a second, got a shorter one")
    tick_ms = schema.column(rows, "tick_ns") * 1e-6
    p50, p99, maximum = np.percentile(tick_ms, [50, 99, 100])
    overruns = schema.column(rows, "overruns")[-1] - schema.column(first, "overruns")[-1]
    late_p99 = np.percentile(schema.column(rows, "late_ns") * 1e-6, 99)
    return Ticks(float(p50), float(p99), float(maximum), float(late_p99), int(overruns))


def _viewer(stack: LiveStack) -> int:
    """Return the viewer's process group, once the whole stack is ready. Raise `LinkError` without
    one.
    """
    for service in stack.ready().services:
        if service.name == VIEWER and service.state == READY:
            # A service is the leader of a separate process group.
            return service.pid
    raise LinkError(f"the run has no viewer to disturb; it said: {stack.last_line()}")


def _table(played: dict[Case, list[Ticks]]) -> list[str]:
    """A line per case; milliseconds."""
    lines = [["", "tick p50", "p99", "max", "late p99", "overruns", "tick p99 / no viewer"]]
    lines.append(["", *["[ms]"] * 4, "", ""])
    without = np.array([ticks.p99 for ticks in played[NOT_WATCHED]])
    for case, runs in played.items():
        ratios = np.array([ticks.p99 for ticks in runs]) / without
        lines.append(
            [
                case.name,
                *(
                    _spanned([getattr(ticks, name) for ticks in runs], digits=3)
                    for name in ("p50", "p99", "maximum", "late_p99")
                ),
                _spanned([ticks.overruns for ticks in runs], digits=0),
                _spanned(ratios.tolist(), digits=2),
            ]
        )
    return aligned(lines, left=1)


def _spanned(values: Sequence[float], *, digits: int) -> str:
    median, least, maximum = (
        f"{value:.{digits}f}" for value in (np.median(values), min(values), max(values))
    )
    return f"{median} ({least}–{maximum})"
