"""Time series for a figure: the errors of one trial, and the delay of its messages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.lockstep import Lockstep
from netem.networks import load_profile
from netem.statistics import delays_ms
from shared.config.settings import RunConfig


@dataclass(frozen=True)
class Trace:
    """Every tick of a task, arrays (n,): `time` [s], `com_error_cm`, `contact_violation_m_s2`.

    `round_trip_ms` is the delay of the state sent in that tick plus that of its answer, inf if one
    is lost. `push` is the pair of times at which the push begins and ends [s], None without a
    push. `mode_changes` are the times of the contact switches [s].
    """

    time: np.ndarray
    com_error_cm: np.ndarray
    contact_violation_m_s2: np.ndarray
    round_trip_ms: np.ndarray
    push: tuple[float, float] | None
    mode_changes: np.ndarray
    fell: bool


def play_trace(config: RunConfig) -> Trace:
    """Play a trial in lockstep over the profile that its configuration names."""
    result = Lockstep(config, all_active_sets=False).run()

    def column(name: str) -> np.ndarray:
        return result.schema.column(result.rows, name)

    begun = column("time_ns") >= 0
    time = column("time_ns")[begun] * 1e-9
    pushed = time[np.any(column("push_n")[begun] != 0.0, axis=1)]
    profile = load_profile(config.link.network)
    round_trips = delays_ms(profile, "round trip")
    sent_ns = column("wall_ns")[begun] + profile.start_offset_ns(config.seed)
    index = (sent_ns // profile.period_ns).astype(int) % len(round_trips)
    return Trace(
        time=time,
        com_error_cm=100.0 * column("com_error_m")[begun],
        contact_violation_m_s2=column("contact_violation_m_s2")[begun],
        round_trip_ms=round_trips[index],
        push=(float(pushed[0]), float(pushed[-1])) if len(pushed) else None,
        mode_changes=time[1:][np.diff(column("mode")[begun]) != 0],
        fell=bool(result.summary["fell"]),
    )
