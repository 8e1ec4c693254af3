"""Speed of a sweep's trials on one core, and the parts of a trial's time.

Whole trials are played as a sweep plays them, from building robot and plan to the summary, one
after another in one process. The result is the median of the repetitions of each trial. The parts
of a tick are timed in place:

    controller   the local controller: b and A†b, or the correction, and the torque
    robot        the rest of the robot: sensing, the reference, codec, cache, guards
    edge         the state decoded; terms, QP, projector, torque; the answer encoded
    plant        a step of MuJoCo, and the check for a fall
    telemetry    the row of the tick, with the metrics in it
    link         all the rest: events, delay lines, bus, rows of messages and solves
"""

from __future__ import annotations

import gc
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.timing import header
from experiments.lockstep import Lockstep
from experiments.reproduction.timed_walk import timed
from shared.config.config_file import load_config
from shared.output.text_table import aligned

_NETWORK = "constant:25ms"
_TASKS = ("balance", "walk")
_CONTROLLERS = ("pr", "la", "lc")
_TICK = ("controller", "robot", "edge", "plant", "telemetry", "link")


@dataclass(frozen=True)
class TrialTime:
    """Times of a trial of `simulated` seconds [s]: building, playing, summary; and of a tick by
    part, as in `_TICK`.
    """

    simulated: float
    built: float
    played: float
    summed_up: float
    of_tick: tuple[float, ...]

    @property
    def per_minute(self) -> float:
        """The number of such trials that one core plays in a minute."""
        return 60.0 / (self.built + self.played + self.summed_up)


def run(*, repetitions: int, seconds: float | None) -> str:
    """Play balance and walk with each controller, and return the table as text."""
    top = header()
    lines = [
        ["", "simulated", "trials/min", "× real time", *_TICK, "tick", "start-up", "summary"],
        ["", "[s]", "per core", "", *["[ms]"] * (len(_TICK) + 3)],
    ]
    for task in _TASKS:
        for controller in _CONTROLLERS:
            timed_trial(task, controller, seconds=0.2)  # warms caches and imports
            each = [timed_trial(task, controller, seconds=seconds) for _ in range(repetitions)]
            lines.append(_line(f"{task}, {controller.upper()}", each))
    length = "whole trials" if seconds is None else f"trials of {seconds:g} s"
    text = f"{length} over {_NETWORK}, medians of {repetitions}; by part the mean of all ticks"
    return "\n".join([f"{top}; {text}", "", *aligned(lines, left=0)])


def timed_trial(task: str, controller: str, *, seconds: float | None) -> TrialTime:
    """Play one trial with a stopwatch in it."""
    given: dict[str, Any] = {"task": task, "controller": controller, "link.network": _NETWORK}
    if seconds is not None:
        given["duration"] = seconds
    config = load_config(None, given)
    gc.collect()
    started = time.perf_counter()
    lockstep = Lockstep(config, all_active_sets=False)
    built = time.perf_counter()
    robot, edge = lockstep.robot, lockstep.edge
    local = [timed(robot.controller, name) for name in ("observe", "command")]
    on_robot = [timed(robot, name) for name in ("measure", "receive", "command")]
    on_edge = [timed(edge, name) for name in ("receive", "step")]
    advance, telemetry = timed(robot, "advance"), timed(robot.tick_row, "fill")
    begun = time.perf_counter()
    result = lockstep.run()
    ended = time.perf_counter()
    ticks = len(result.rows)
    # The summary has the time from the first event to the last.
    simulated = result.summary["task_seconds"]
    played = simulated / result.summary["realtime_factor"]

    def of_tick(*durations: list[int]) -> float:
        return 1e-9 * sum(map(sum, durations)) / ticks

    parts = [
        of_tick(*local),
        of_tick(*on_robot) - of_tick(*local),
        of_tick(*on_edge),
        of_tick(advance) - of_tick(telemetry),
        of_tick(telemetry),
    ]
    return TrialTime(
        simulated=simulated,
        built=built - started,
        played=played,
        summed_up=ended - begun - played,
        of_tick=(*parts, played / ticks - sum(parts)),
    )


def _line(name: str, trials: list[TrialTime]) -> list[str]:
    def median(values: list[float]) -> float:
        return float(np.median(values))

    by_part = np.median([trial.of_tick for trial in trials], axis=0)
    return [
        name,
        f"{median([trial.simulated for trial in trials]):.1f}",
        f"{median([trial.per_minute for trial in trials]):.1f}",
        f"{median([trial.simulated / trial.played for trial in trials]):.2f}",
        *(f"{1e3 * part:.3f}" for part in by_part),
        f"{1e3 * by_part.sum():.3f}",
        f"{1e3 * median([trial.built for trial in trials]):.0f}",
        f"{1e3 * median([trial.summed_up for trial in trials]):.0f}",
    ]
