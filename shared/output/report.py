"""The report of a run: the part of each process, from its rows. `summary` joins the parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shared.output.fall import fall_report
from shared.output.link_met import DIRECTIONS
from shared.telemetry.metrics import (
    active_set_discrepancy,
    by_cardinality,
    in_task,
    largest,
    log_hash,
    mean,
    quantiles,
    stance_slips,
    switch_to_fresh_ms,
    ticks_by_cardinality,
    true_active_sets,
)
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, Schema, Source

_ERRORS = ("com_error_m", "contact_violation_m_s2")


def robot_report(
    schema: Schema,
    rows: np.ndarray,
    *,
    fell: bool | None,
    wall_seconds: float,
    sent: int,
    received: int | None,
    lost: int | None,
    refused: dict[str, int] | None,
    answers: dict[str, dict[str, int]] | None,
    sensor_faults: dict[str, int] | None,
    base_estimate: dict[str, int] | None,
    torque_limits: Mapping[str, float],
) -> dict[str, Any]:
    """Return the robot's part, from its tick rows; rows before the task began are left out.

    None: unknown, because the process was killed.

    The robot has `sent` a state in every tick, but the file of a long run has rows of its first
    ticks only. `task_seconds` counts all ticks, `measured_seconds` those with a row. All other
    figures come from the rows. `torque_limits` are those of the joints [N m], by name.
    `base_estimate` counts the `jumps` and `drifts` of the base's estimate that the robot has
    followed. `answers_used` is the number of states of the task whose answers were used.
    `youngest_answer_ms` is the age of the youngest answer at its use, also before the task; None
    without an answer.
    """
    unmeasured = max(0, sent - len(rows))
    ages_ns = schema.column(rows, "projector_age_ns")
    youngest_ns = ages_ns[ages_ns >= 0].min(initial=np.inf)
    rows = in_task(schema, rows)

    def column(name: str) -> np.ndarray:
        return schema.column(rows, name)

    source, used = column("source"), column("projector_sequence")
    age_ms = column("projector_age_ns") * 1e-6
    violation = column("contact_violation_m_s2")
    waits = switch_to_fresh_ms(schema, rows)
    seconds = (len(rows) + unmeasured) * 1e-3
    return {
        "fell": fell,
        "fall": fall_report(schema, rows, torque_limits=torque_limits) if fell else None,
        "task_seconds": round(seconds, 3),
        "measured_seconds": round(len(rows) * 1e-3, 3),
        "com_error_m": mean(column("com_error_m")),
        "contact_violation_m_s2": mean(violation),
        "foot_slip_mm": quantiles(stance_slips(schema, rows) * 1e3),
        "switch_to_fresh_ms": {**quantiles(waits), "never": int(np.isnan(waits).sum())},
        "saturated_ticks": int(np.sum(column("torque_ratio") >= 1.0)),
        "joint_beyond_rad": largest(column("joint_beyond_rad")),
        "joint_speed_ratio": largest(column("joint_speed_ratio")),
        "on_board_qps": int(column("on_board_qps")[-1]) if len(rows) else 0,
        "commands": {each.label: int(np.sum(source == each)) for each in Source},
        "projector_age_ms": quantiles(age_ms[age_ms >= 0]),
        "youngest_answer_ms": round(youngest_ns * 1e-6, 4) if np.isfinite(youngest_ns) else None,
        "answers_used": len(np.unique(used[used >= column("tick")[0]])) if len(rows) else 0,
        "robot_tick_ms": quantiles(column("tick_ns") * 1e-6),
        "tick_lateness_ms": quantiles(column("late_ns") * 1e-6),
        "overruns": int(column("overruns")[-1]) if len(rows) else 0,
        "realtime_factor": round(seconds / wall_seconds, 4) if wall_seconds > 0 else None,
        "sensor_faults": sensor_faults,
        "base_estimate": base_estimate,
        "log_hash": log_hash(schema, rows),
        "link": {
            "uplink": {"sent": sent},
            "downlink": {
                "received": received,
                "lost": lost,
                "refused": refused,
                "answers": answers,
            },
        },
    }


def edge_report(
    rows: np.ndarray,
    *,
    statuses: dict[str, int],
    sent: int | None,
    received: int | None,
    lost: int | None,
    refused: dict[str, int] | None,
) -> dict[str, Any]:
    """Return the edge's part, from its solve rows. None: unknown, as in `robot_report`."""
    return {
        "edge_solve_ms": quantiles(SOLVE_SCHEMA.column(rows, "solve_ns") * 1e-6),
        "edge_solves": statuses,
        "link": {
            "uplink": {"received": received, "lost": lost, "refused": refused},
            "downlink": {"sent": sent},
        },
    }


def link_report(rows: np.ndarray, *, profile: Mapping[str, Any], passes: int) -> dict[str, Any]:
    """Return the shim's part, from its message rows: nominal delay, and achieved minus nominal.

    `profile` is a `netem.profile.profile_report`, of which the name alone is always known.
    """
    unknown = dict.fromkeys(("profile_seconds", "profile_begins_s", "profile_worst_outage"))
    report: dict[str, Any] = {**unknown, **profile, "profile_passes": passes, "link": {}}
    directions = LINK_SCHEMA.column(rows, "direction")
    seconds = float(np.ptp(LINK_SCHEMA.column(rows, "wall_ns"))) * 1e-9 if len(rows) else 0.0
    for k, name in enumerate(DIRECTIONS):
        way = rows[directions == k]
        nominal = LINK_SCHEMA.column(way, "nominal_ns")
        achieved = LINK_SCHEMA.column(way, "achieved_ns")
        passed = achieved >= 0
        n_bytes = LINK_SCHEMA.column(way, "bytes")
        report["link"][name] = {
            "bytes_per_second": round(float(n_bytes.sum()) / seconds, 1) if seconds > 0.0 else None,
            "dropped_by_profile": int(np.sum(~passed)),
            "bytes_per_message": quantiles(n_bytes),
            "nominal_delay_ms": quantiles(nominal[passed] * 1e-6),
            "delay_error_ms": quantiles((achieved - nominal)[passed] * 1e-6),
        }
    return report


def discrepancy_report(schema: Schema, rows: np.ndarray, solve_rows: np.ndarray) -> dict[str, Any]:
    """Return by how many rows the active sets in use differ from the true ones.

    The true active set of a tick is in the edge's solve of the tick's state, if there is one. The
    lists are Table VI, indexed by the cardinality: the number of ticks, and their mean errors.
    """
    rows = in_task(schema, rows)
    cardinality = active_set_discrepancy(schema, rows, true_active_sets(schema, rows, solve_rows))
    return discrepancy_of(cardinality, *(schema.column(rows, name) for name in _ERRORS))


def discrepancy_of(cardinality: np.ndarray, *errors: np.ndarray) -> dict[str, Any]:
    """Return the report of cardinalities (n,), with the two errors of the same ticks."""
    return {
        "mean": mean(cardinality),
        **quantiles(cardinality),
        "ticks": ticks_by_cardinality(cardinality),
        **{
            name: by_cardinality(cardinality, values)
            for name, values in zip(_ERRORS, errors, strict=True)
        },
    }


def merge(*parts: dict[str, Any] | None) -> dict[str, Any]:
    """Join the reports of several processes; nested maps are joined, missing parts left out."""
    merged: dict[str, Any] = {}
    for part in parts:
        for key, value in (part or {}).items():
            if isinstance(value, dict) and isinstance(merged.get(key), dict):
                merged[key] = merge(merged[key], value)
            else:
                merged[key] = value
    return merged
