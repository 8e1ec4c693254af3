"""The reasons for which a run is not a result about the link.

A run in real time depends on the machine too. If the machine adds delays that the link does not
have, or slows simulated time down, then neither a fall nor a stand tells anything about the link.
Overruns alone do not: a robot that catches up within milliseconds stands or falls as it would.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from shared.config.extensions import corrects
from shared.config.settings import RunConfig
from shared.output.link_met import DIRECTIONS
from shared.output.no_start import carried_in_words
from shared.telemetry.metrics import in_task, quantiles
from shared.telemetry.outages import OUTAGE_NS
from shared.telemetry.row_log import MAX_ROWS
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, Schema

# The least ratio of simulated time to real time. A delay of the link is shorter for a slower robot.
# At 0.95 the error is below the resolution of the paper's tables. An idle machine reaches 1.00.
REALTIME_FACTOR = 0.95
# The largest share of ticks that overran. Two slow cores have 1 to 9 % with nothing else to do, and
# the ages in use are then right within milliseconds. A busy machine without real-time priority has
# 34 to 99 %: the ticks come in bunches, on the same answer.
OVERRUNS = 0.2
# The largest delay that edge or shim may add, median [ms]. PR stands a round trip of 30 ms and
# falls at 40 ms: with 10 ms more, the verdict is about another link. Two slow cores have 2 to 5 ms.
ADDED_MS = 10.0
# The longest time for which robot, shim or edge may stand still [s], LA and PR, and LC, whose edge
# answers ten times a second. A median does not show it. LA stands an outage of 0.25 s at a push.
# Two slow cores with other work have 0.04 to 0.08 s; 0.4 to 5 s beside a second stack, or beside
# programs of a higher priority.
STALL_SECONDS, STALL_SECONDS_CORRECTED = 0.25, 1.0
# The cores that robot, edge and shim of one stack take at 1 kHz.
CORES_PER_STACK = 2


@dataclass(frozen=True)
class Machine:
    """The machine of a run in real time: its `cores`, and the largest number of other stacks.

    `other_cores` is the mean number of cores that processes of others took, None if unknown.
    `stalls_s` has the longest time for which each part stood still, as `stalls_s` finds it.
    `edge_ms` has quantiles of the time from the arrival of a state at the edge, by the profile,
    until an answer to it or to a newer one leaves. `shim_ms` has those of the shim's lateness, for
    each direction, without messages that waited in an outage. Both are empty if unknown.
    """

    cores: int
    other_stacks: int = 0
    edge_ms: Mapping[str, float | None] | None = None
    shim_ms: Mapping[str, Mapping[str, float | None]] | None = None
    other_cores: float | None = None
    stalls_s: Mapping[str, float] | None = None

    def report(self) -> dict[str, Any]:
        """Return the part of the summary."""
        return {
            "cores": self.cores,
            "other_stacks": self.other_stacks,
            "other_cores": None if self.other_cores is None else round(self.other_cores, 2),
            "stalls_s": dict(self.stalls_s or {}),
            "edge_ms": dict(self.edge_ms or quantiles(np.empty(0))),
            "shim_ms": {
                name: dict((self.shim_ms or {}).get(name, quantiles(np.empty(0))))
                for name in DIRECTIONS
            },
        }


def stalls_s(
    schema: Schema, rows: np.ndarray, link_rows: np.ndarray, solve_rows: np.ndarray | None
) -> dict[str, float]:
    """Return the longest time of the task in which each part of this machine stood still [s].

    `uplink`: no state of the robot came to the shim. `end`: none was released until the end of the
    run, beyond the longest delay so far. `shim`: a message waited longer than its delay, and not
    behind those of an outage. `edge`: while states came, no answer left to one or to a newer one;
    not without `solve_rows`.
    """
    rows = in_task(schema, rows)
    if len(link_rows) >= MAX_ROWS:
        # The files of the services of a long run end at different times.
        ended_ns = LINK_SCHEMA.column(link_rows, "wall_ns").max()
        rows = rows[schema.column(rows, "wall_ns") <= ended_ns]
    if not len(rows):
        return {}
    ticks, wall_ns = schema.column(rows, "tick"), schema.column(rows, "wall_ns")
    sequence, sent_ns, direction, nominal_ns, achieved_ns = (
        LINK_SCHEMA.column(link_rows, name)
        for name in ("sequence", "wall_ns", "direction", "nominal_ns", "achieved_ns")
    )
    of_task = (sent_ns >= wall_ns[0]) & (sent_ns <= wall_ns[-1])
    # Only the numbers of the robot's ticks: another message on the key is no state of it.
    up, passed = of_task & (direction == 0) & np.isin(sequence, ticks), achieved_ns >= 0
    # A state under way at the end has no row.
    known = np.unique(sequence[up])
    later = int((ticks > known.max(initial=-1)).sum())
    absent = np.setdiff1d(ticks[: len(ticks) - later], known)
    runs = np.split(absent, np.flatnonzero(np.diff(absent) > 1) + 1)
    found = {
        "uplink": max(len(run) for run in runs) * 1e-3,
        "end": max(0.0, later * 1e-3 - nominal_ns[up].max(initial=0.0) * 1e-9),
    }
    waited = _waited(link_rows)
    late_ns = (achieved_ns - nominal_ns)[
        of_task & passed & ~waited & ~_behind(waited, direction, sent_ns, achieved_ns)
    ]
    found["shim"] = float(late_ns.max(initial=0.0)) * 1e-9
    if solve_rows is not None:
        order = np.argsort(sequence[up & passed], kind="stable")
        arrival_ns = (sent_ns + nominal_ns)[up & passed][order]
        left_ns = _left_ns(sequence[up & passed][order], solve_rows)
        # After the last state the edge has nothing to answer.
        left_ns[np.isinf(left_ns)] = arrival_ns.max(initial=0.0)
        stood_ns = np.minimum(left_ns, wall_ns[-1]) - arrival_ns
        stood_ns -= _silence_ns(arrival_ns, until_ns=left_ns)
        found["edge"] = float(stood_ns.max(initial=0.0)) * 1e-9
    return {part: round(seconds, 4) for part, seconds in found.items()}


def _waited(link_rows: np.ndarray) -> np.ndarray:
    """Return which messages waited in an outage of their direction and then passed."""
    direction, nominal_ns, achieved_ns = (
        LINK_SCHEMA.column(link_rows, name) for name in ("direction", "nominal_ns", "achieved_ns")
    )
    waited = np.zeros(len(link_rows), dtype=bool)
    for way in range(len(DIRECTIONS)):
        passed = (direction == way) & (achieved_ns >= 0)
        least_ns = nominal_ns[passed].min(initial=np.inf)
        waited |= passed & (nominal_ns > least_ns + OUTAGE_NS)
    return waited


def _behind(
    waited: np.ndarray, direction: np.ndarray, sent_ns: np.ndarray, achieved_ns: np.ndarray
) -> np.ndarray:
    """Return which messages were sent before the release of an earlier one that had `waited`."""
    behind = np.zeros(len(waited), dtype=bool)
    for way in range(len(DIRECTIONS)):
        of_way = np.flatnonzero(direction == way)
        order = of_way[np.argsort(sent_ns[of_way], kind="stable")]
        released_ns = np.where(waited, sent_ns + achieved_ns, 0.0)[order]
        behind[order] = sent_ns[order] < np.maximum.accumulate(released_ns)
    return behind


def _silence_ns(arrival_ns: np.ndarray, *, until_ns: np.ndarray) -> np.ndarray:
    """Return for how long no state came between each arrival and its `until_ns`.

    Only pauses longer than an outage count: the edge of LC has nothing to answer in them.
    """
    arrived_ns = np.sort(arrival_ns)
    pauses_ns = np.diff(arrived_ns, prepend=arrived_ns[:1])
    silent_ns = np.append(0.0, np.cumsum(np.where(pauses_ns > OUTAGE_NS, pauses_ns, 0.0)))
    begin, end = (
        np.searchsorted(arrived_ns, each, side="right") for each in (arrival_ns, until_ns)
    )
    found: np.ndarray = silent_ns[end] - silent_ns[begin]
    return found


def _left_ns(sequence: np.ndarray, solve_rows: np.ndarray) -> np.ndarray:
    """Return when an answer to each state or to a newer one left [ns]; inf without one."""
    answered = np.maximum.accumulate(SOLVE_SCHEMA.column(solve_rows, "state_sequence"))
    left_ns = SOLVE_SCHEMA.column(solve_rows, "wall_ns") + SOLVE_SCHEMA.column(
        solve_rows, "solve_ns"
    )
    found: np.ndarray = np.append(left_ns, np.inf)[np.searchsorted(answered, sequence)]
    return found


def edge_ms(
    schema: Schema, rows: np.ndarray, link_rows: np.ndarray | None, solve_rows: np.ndarray
) -> dict[str, float | None]:
    """Return quantiles of the edge's time from a state to an answer that is at least as new [ms].

    Without rows of a shim, a state reaches the edge when it is measured.
    """
    if link_rows is None:
        rows = in_task(schema, rows)
        sequence, arrival_ns = schema.column(rows, "tick"), schema.column(rows, "wall_ns")
    else:
        passed = LINK_SCHEMA.column(link_rows, "achieved_ns") >= 0
        up = link_rows[(LINK_SCHEMA.column(link_rows, "direction") == 0) & passed]
        up = up[np.argsort(LINK_SCHEMA.column(up, "sequence"), kind="stable")]
        sequence = LINK_SCHEMA.column(up, "sequence")
        arrival_ns = LINK_SCHEMA.column(up, "wall_ns") + LINK_SCHEMA.column(up, "nominal_ns")
    # An unanswered state is none of the finite values.
    return quantiles((_left_ns(sequence, solve_rows) - arrival_ns) * 1e-6)


def shim_ms(link_rows: np.ndarray) -> dict[str, dict[str, float | None]]:
    """Return quantiles of how late the shim released messages [ms], for each direction.

    Messages that waited in an outage are left out: at its end hundreds are due at once.
    """
    direction, nominal_ns, achieved_ns = (
        LINK_SCHEMA.column(link_rows, name) for name in ("direction", "nominal_ns", "achieved_ns")
    )
    soon = (achieved_ns >= 0) & ~_waited(link_rows)
    late_ms = (achieved_ns - nominal_ns) * 1e-6
    return {
        name: quantiles(late_ms[soon & (direction == way)]) for way, name in enumerate(DIRECTIONS)
    }


def invalid_reasons(
    summary: Mapping[str, Any], config: RunConfig, machine: Machine | None
) -> list[str]:
    """Return why a run that has begun is not a result about the link; [] if it is one.

    `machine` is None under simulated time, which does not depend on the machine.
    """
    reasons = [] if machine is None else _too_slow(summary, config, machine)
    expires = not corrects(config.controller)
    if expires and summary["answers_used"] == 0 and summary["commands"]["held"]:
        reasons.append(
            "no answer was ever fresh enough: those to the states of the task were older than "
            f"{1e3 * config.loop.hold_after:g} ms (loop.hold_after){carried_in_words(summary)}; "
            "the robot held its joints"
        )
    return reasons


def _too_slow(summary: Mapping[str, Any], config: RunConfig, machine: Machine) -> list[str]:
    slow = []
    ticks = summary["measured_seconds"] * 1e3
    factor = summary["realtime_factor"]
    if factor is not None and factor < REALTIME_FACTOR:
        slow.append(f"simulated time ran at {factor:.2f} × real time")
    if ticks and (overran := summary["overruns"] / ticks) > OVERRUNS:
        slow.append(f"{100 * overran:.0f} % of the ticks ended too late")
    answers = not corrects(config.controller)
    edge = (machine.edge_ms or {}).get("p50")
    if answers and edge is not None and edge > ADDED_MS:
        received = summary["link"]["uplink"]["received"]
        share = summary["link"]["downlink"]["sent"] / received if received else 0.0
        slow.append(
            f"the edge answered {100 * share:.0f} % of the states, {edge:.0f} ms after they came "
            "(median)"
        )
    for name, late in (machine.shim_ms or {}).items():
        median = late["p50"]
        if median is not None and median > ADDED_MS:
            slow.append(f"the {name} was {median:.0f} ms longer than the profile (median)")
    slow += _stalls(machine, answers=answers, outage_s=_longest_outage_s(summary, config))
    reasons = [f"the machine was too slow: {', '.join(slow)}"] if slow else []
    others = machine.other_stacks
    if others and machine.cores < CORES_PER_STACK * (1 + others):
        beside = "a second stack" if others == 1 else f"{others} other stacks"
        reasons.append(f"{beside} ran beside it on {machine.cores} cores")
    return reasons


def _longest_outage_s(summary: Mapping[str, Any], config: RunConfig) -> float:
    """Return the longest outage of the profile and the settings together [s]."""
    profile_ms = (summary.get("profile_worst_outage") or {}).get("ms", 0.0)
    ours_ns = [each.duration_ns or 0 for each in config.link.outages]
    return float(profile_ms) * 1e-3 + max(ours_ns, default=0) * 1e-9


def _stalls(machine: Machine, *, answers: bool, outage_s: float) -> list[str]:
    """Return the parts of the machine that stood still for too long, in words.

    Until `outage_s` [s] before the end, the link itself may hold all messages back.
    """
    words = {
        "uplink": "no state of the robot came to the shim",
        "end": "the shim released no state before the end",
        "shim": "the shim held a message back",
        "edge": "no answer left the edge",
    }
    stalls = machine.stalls_s or {}
    limits = dict.fromkeys(words, STALL_SECONDS)
    limits["end"] += outage_s
    if not answers:
        limits["edge"] = STALL_SECONDS_CORRECTED
    return [
        f"{text} for {stalls[part]:.2f} s"
        for part, text in words.items()
        if stalls.get(part, 0.0) > limits[part]
    ]
