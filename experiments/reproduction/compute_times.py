"""Table V: computation times of the full QP and the local controllers in a walk; message sizes.

Each controller walks in lockstep over one profile of the burning building, with the garbage
collector off and the process on one core. The computations of the robot and the edge are timed in
place, between those of the other node and of the plant. Their caches are therefore colder than on
two computers. The full QP is timed on the states that LA measured. Repetitions of a walk are the
same to the last bit. So the least time of a tick is the one with the fewest interruptions.

A slow computer's times are these times multiplied by a compute-time scale. That is a model: no
clock was changed.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.reproduction.timed_walk import (
    WARM_UP_TICKS,
    TimedWalk,
    full_controller,
    one_core,
)
from netem.profile import DOWNLINK, UPLINK
from shared.config.config_file import load_config
from shared.output.link_met import DIRECTIONS
from shared.output.versions import cpu_name, versions

NETWORK = "building/001"
QUICK_SECONDS = 3.0

CONTROLLERS = ("pr", "la", "lc")
QP = "full QP: condensed, solved, projector"
FULL_CONTROLLER = "full controller: b and matrices, QP, torque"
LOCAL = {name: f"{name.upper()} local controller" for name in CONTROLLERS}
ROBOT_TICK = {
    name: f"{name.upper()} robot tick: also measure, encode, decode" for name in CONTROLLERS
}
EDGE_STEP = {name: f"{name.upper()} edge step: answer a state, encode" for name in CONTROLLERS}


@dataclass(frozen=True)
class Time:
    """Times of one computation over `calls` calls [ms].

    `undisturbed_worst_ms` is the maximum over the calls of the minimum over the repetitions.
    """

    name: str
    calls: int
    mean_ms: float
    p99_ms: float
    worst_ms: float
    undisturbed_worst_ms: float

    @classmethod
    def of(cls, name: str, durations_ns: np.ndarray) -> Time:
        """Statistics of durations [ns], shape (repetitions, calls)."""
        ms = durations_ns * 1e-6
        return cls(
            name=name,
            calls=ms.size,
            mean_ms=float(ms.mean()),
            p99_ms=float(np.percentile(ms, 99)),
            worst_ms=float(ms.max()),
            undisturbed_worst_ms=float(ms.min(axis=0).max()),
        )

    @property
    def quantiles_ms(self) -> tuple[float, float, float, float]:
        """Mean, p99, worst, and worst undisturbed call."""
        return self.mean_ms, self.p99_ms, self.worst_ms, self.undisturbed_worst_ms


@dataclass(frozen=True)
class MessageSize:
    """Size [bytes] and rate [1/s] of the messages of one controller in one direction."""

    controller: str
    direction: str
    mean_bytes: float
    most_bytes: int
    per_second: float


@dataclass(frozen=True)
class ComputeTimes:
    """Table V, measured. `scale` is the compute-time scale of the robot's slow computer."""

    network: str
    seconds: float
    repetitions: int
    scale: float
    pinned: bool
    cpu: str
    versions: dict[str, str]
    times: tuple[Time, ...]
    messages: tuple[MessageSize, ...]

    @property
    def columns(self) -> list[str]:
        """Headings of `rows`."""
        measured = ["mean [ms]", "p99", "worst", "undisturbed"]
        return ["", *measured, *(f"× {self.scale:g}: {name}" for name in measured)]

    def rows(self) -> list[list[str]]:
        """A line of text for each computation, at full speed and scaled."""
        return [
            [
                each.name,
                *(
                    f"{factor * value:.3f}"
                    for factor in (1.0, self.scale)
                    for value in each.quantiles_ms
                ),
            ]
            for each in self.times
        ]

    message_columns = ("", "direction", "bytes per message, mean", "most", "messages per second")

    def message_rows(self) -> list[list[str]]:
        """A line of text for each controller and direction."""
        return [
            [
                each.controller.upper(),
                each.direction,
                f"{each.mean_bytes:.0f}",
                f"{each.most_bytes}",
                f"{each.per_second:.0f}",
            ]
            for each in self.messages
        ]

    @property
    def note(self) -> str:
        """The conditions of the measurement, in sentences."""
        core = "one core" if self.pinned else "any core (the system does not allow one alone)"
        return (
            f"A walk of {self.seconds:g} s over {self.network} was played {self.repetitions} × on "
            f"{core}. The first {WARM_UP_TICKS} ticks are left out. The garbage collector was off. "
            f"The processor was {self.cpu}. *Undisturbed* is the worst tick, with the least time "
            f"of its repetitions for each tick. × {self.scale:g} is the compute-time scale, a "
            "factor and not another clock."
        )

    def time(self, name: str) -> Time:
        """The times of one computation."""
        return next(each for each in self.times if each.name == name)

    def as_json(self) -> dict[str, Any]:
        """The fields as a dictionary for `json.dumps`."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> ComputeTimes:
        """Read the dictionary that `as_json` returned."""
        times = tuple(Time(**each) for each in fields["times"])
        messages = tuple(MessageSize(**each) for each in fields["messages"])
        return cls(**{**fields, "times": times, "messages": messages})


def measure(
    *, repetitions: int = 3, seconds: float | None = None, network: str = NETWORK, seed: int = 0
) -> ComputeTimes:
    """Play the walk `repetitions` times with each controller, and time its computations.

    `seconds` shortens the walk. It must be at least 1 s, so that ticks are left after the warm-up.
    """
    given = {"task": "walk", "link.network": network, "seed": seed, "walk.double_support": 0.005}
    if seconds is not None:
        given["duration"] = seconds
    local, whole, steps, messages = [], [], [], []
    with one_core() as pinned:
        for name in CONTROLLERS:
            config = load_config(None, {**given, "controller": name})
            walks = [TimedWalk(config) for _ in range(repetitions)]
            local.append(Time.of(LOCAL[name], np.array([walk.local_ns for walk in walks])))
            whole.append(Time.of(ROBOT_TICK[name], np.array([walk.tick_ns for walk in walks])))
            steps.append(Time.of(EDGE_STEP[name], np.array([walk.edge_ns for walk in walks])))
            messages += [_size(name, direction, walks[0]) for direction in (UPLINK, DOWNLINK)]
            if name == "la":
                states = walks[0].states
        qp_ns, full_ns = full_controller(config, states, repetitions)
    return ComputeTimes(
        network=network,
        seconds=config.duration,
        repetitions=repetitions,
        scale=config.switch.compute_time_scale,
        pinned=pinned,
        cpu=cpu_name(),
        versions=versions(),
        times=(Time.of(QP, qp_ns), Time.of(FULL_CONTROLLER, full_ns), *local, *whole, *steps),
        messages=tuple(messages),
    )


def _size(controller: str, direction: int, walk: TimedWalk) -> MessageSize:
    sizes = walk.message_bytes(direction)
    return MessageSize(
        controller=controller,
        direction=DIRECTIONS[direction],
        mean_bytes=float(sizes.mean()),
        most_bytes=int(sizes.max()),
        per_second=len(sizes) / walk.seconds,
    )
