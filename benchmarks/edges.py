"""Edges that are shared or die, on a live stack: measured, and nothing asserted.

`flood`: one edge serves two robots over 10 ms. The second one sends at 1 kHz and at a higher rate
in turn. The result has the ages of the first one's answers at both rates, with LA.

`kills`: two edges behind a router serve one robot. Every 5 s one of them is killed, in turn, as
soon as the other one is ready. The result has the robot's verdict, and counts its lines about
missing answers.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.faults.stacks import Command, Stacks, stacks, state_of
from benchmarks.link_paths import free_endpoints
from benchmarks.timing import cores_busy, header_of_processes
from deploy.background.state import READY
from shared.errors import LinkError
from shared.output.text_table import aligned
from shared.telemetry.parquet import read_parquet

_NETWORK = "constant:10ms"
_FIRST, _SECOND = "amy", "ben"
HONEST_RATE, RATE = 1000, 20_000
# The time at one rate, and between two kills [s].
_TURN_SECONDS, _KILL_SECONDS = 5.0, 5.0
_POLL_SECONDS = 0.05
# Ticks after a change of the rate are left out, and those of the first second [ns].
_SETTLING_NS, _WARM_UP_NS = 500_000_000, 1_000_000_000
_NO_ANSWER, _MOST_LINES = "no answer for", 5

# The time of a change of the rate by the machine's monotonic clock [ns], the new rate, and the
# number of messages before it.
Change = tuple[int, int, int]


def run_flood(*, seconds: float, rate: int) -> str:
    """Play two robots on one edge. Return the ages of the first one's answers as text."""
    busy = cores_busy(seconds=2.0)
    with _folder() as them:
        (endpoint,) = free_endpoints(1)
        names = f"{_FIRST},{_SECOND}"
        edge = _up(them, "edge", "--only", "edge", "--listen", endpoint, "--name", names)
        edge.wait_for("READY")
        flood = them.start(
            *("benchmarks.fast_robot", "--endpoint", endpoint, "--name", _SECOND),
            *("--rates", f"{HONEST_RATE},{rate}", "--seconds", f"{_TURN_SECONDS:g}"),
        )
        flood.wait_for("READY")
        robot = _up(
            *(them, "robot", "--only", "netem,robot", "--edge", endpoint, "--name", _FIRST),
            *("--network", _NETWORK, "--duration", f"{seconds:g}"),
        )
        # The runs of benchmarks may last longer than the faults' helpers wait.
        robot.popen.wait()
        flood.signal(signal.SIGTERM)
        flood.wait()
        verdict, ages, changes = _verdict(robot), _ages(them.folder / "robot"), flood.output
    return "\n".join(
        [
            header_of_processes(busy),
            f"balance with LA over {_NETWORK} for {seconds:g} s, beside another robot: {verdict}",
            "",
            *_by_rate(ages, _changes(changes)),
        ]
    )


def run_kills(*, seconds: float, controller: str) -> str:
    """Kill one of two edges again and again. Return what the robot noticed as text."""
    busy = cores_busy(seconds=2.0)
    with _folder() as them:
        (endpoint,) = free_endpoints(1)
        router = _up(them, "router", "--only", "router", "--listen", endpoint)
        router.wait_for("READY")
        edges = [them.folder / f"edge.{number}" for number in range(2)]
        for edge in edges:
            up = _up(
                them, edge.name, "--only", "edge", "--router", endpoint, "--controller", controller
            )
            up.wait_for("READY")
        robot = _up(
            *(them, "robot", "--only", "robot", "--edge", endpoint, "--controller", controller),
            *("--duration", f"{seconds:g}"),
        )
        robot.wait_for("the task begins")
        kills = _kill_in_turn(robot, edges)
        verdict, ages = _verdict(robot), _ages(them.folder / "robot")
        lines = [line.strip() for line in robot.output.splitlines() if _NO_ANSWER in line]
    result = [
        header_of_processes(busy),
        f"balance with {controller.upper()} for {seconds:g} s on two edges: {verdict}",
        f"edges killed: {kills}; lines about missing answers: {len(lines)}",
        *lines[:_MOST_LINES],
    ]
    if controller == "la":
        # LC's factorisations may be of any age.
        p50, p99, most = np.percentile(ages[:, 1], [50, 99, 100]) * 1e-6
        result.append(f"age of the answers: p50 {p50:.1f}, p99 {p99:.1f}, at most {most:.1f} ms")
    return "\n".join(result)


@contextlib.contextmanager
def _folder() -> Iterator[Stacks]:
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name, stacks(Path(name)) as them:
        yield them


def _up(them: Stacks, out: str, *flags: str) -> Command:
    return them.start(
        *("deploy", "up", *flags, "--push", "none", "--view", "off"),
        *("--out", str(them.folder / out)),
    )


def _kill_in_turn(robot: Command, edges: list[Path]) -> int:
    """Kill the edges in turn until the robot's run ends. Return the number of kills."""

    def over() -> bool:
        return robot.popen.poll() is not None

    kills, due = 0, time.monotonic() + _KILL_SECONDS
    while not over():
        time.sleep(_POLL_SECONDS)
        victim, other = (_pid(edge) for edge in edges)
        if kills % 2:
            victim, other = other, victim
        if time.monotonic() < due or not (victim and other):
            continue
        with contextlib.suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
            kills += 1
        due = time.monotonic() + _KILL_SECONDS
    return kills


def _pid(run: Path) -> int:
    """Return the process of the edge of a run; 0 if it is not ready."""
    state = state_of(run)
    for service in () if state is None else state.services:
        if service.name == "edge" and service.state == READY:
            return service.pid
    return 0


def _verdict(robot: Command) -> str:
    """Return the first line of the robot's summary. Raise `LinkError` if it gave none."""
    for line in robot.output.splitlines():
        for word in ("Stands after", "FELL after", "NO RESULT"):
            if word in line:
                return line[line.index(word) :].strip()
    raise LinkError(f"the robot's run has no result; it said: {robot.output[-300:]}")


def _ages(run: Path) -> np.ndarray:
    """Return the robot's clock and the age of the answer in every tick of the task [ns], (n, 2).

    Ticks of the first second are left out. A tick without an answer has the age NaN.
    """
    columns = ("time_ns", "wall_ns", "projector_age_ns")
    schema, rows = read_parquet(run / "telemetry.parquet", columns=columns)
    rows = rows[schema.column(rows, "time_ns") >= _WARM_UP_NS]
    wall_ns, age_ns = (schema.column(rows, name).astype(float) for name in columns[1:])
    return np.column_stack([wall_ns, np.where(age_ns >= 0.0, age_ns, np.nan)])


def _changes(output: str) -> list[Change]:
    """Return the changes of the rate that the second robot has printed."""
    found = []
    for line in output.splitlines():
        if line.startswith("RATE "):
            at_ns, rate, sent = (int(word) for word in line.split()[1:])
            found.append((at_ns, rate, sent))
    return found


def _by_rate(ages: np.ndarray, changes: list[Change]) -> list[str]:
    """Return a table of the ages at each rate of the other robot, with ratios to the first rate.

    The rate that the other robot has reached stands beside the one that was asked for.
    """
    spans: dict[int, list[np.ndarray]] = {}
    reached: dict[int, list[float]] = {}
    for (begin_ns, rate, before), (end_ns, _, after) in itertools.pairwise(changes):
        within = (ages[:, 0] >= begin_ns + _SETTLING_NS) & (ages[:, 0] < end_ns)
        spans.setdefault(rate, []).append(ages[within, 1])
        reached.setdefault(rate, []).append((after - before) / (end_ns - begin_ns) * 1e9)
    lines = [["other robot [1/s]", "reached", "ticks", "no answer", "age p50 [ms]", "p99", "ratio"]]
    quiet = math.nan
    for rate, parts in spans.items():
        found = np.concatenate(parts)
        known = found[np.isfinite(found)]
        if not len(known):
            continue
        p50, p99 = np.percentile(known, [50, 99]) * 1e-6
        quiet = p99 if math.isnan(quiet) else quiet
        lines.append(
            [
                f"{rate}",
                f"{np.mean(reached[rate]):.0f}",
                f"{len(found)}",
                f"{len(found) - len(known)}",
                f"{p50:.2f}",
                f"{p99:.2f}",
                f"{p99 / quiet:.2f}",
            ]
        )
    return aligned(lines, left=0)
