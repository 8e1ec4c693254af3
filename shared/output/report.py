"""The report of a run: a part of each process, from its rows, and the summary of all parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from shared.config.extensions import CONTROLLERS, TASKS, corrects
from shared.config.settings import RunConfig
from shared.output.versions import versions
from shared.telemetry.metrics import (
    active_set_discrepancy,
    by_cardinality,
    in_task,
    log_hash,
    mean,
    quantiles,
    stance_slips,
    switch_to_fresh_ms,
    ticks_by_cardinality,
    true_active_sets,
)
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, Schema, Source

DIRECTIONS = ("uplink", "downlink")
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
) -> dict[str, Any]:
    """Return the robot's part, from its tick rows; rows before the task began are left out.

    None: unknown, because the process was killed.

    The robot has `sent` a state in every tick, but the file of a long run has rows of its first
    ticks only. `task_seconds` counts all ticks, `measured_seconds` those with a row. All other
    figures come from the rows.
    """
    unmeasured = max(0, sent - len(rows))
    rows = in_task(schema, rows)

    def column(name: str) -> np.ndarray:
        return schema.column(rows, name)

    source = column("source")
    age_ms = column("projector_age_ns") * 1e-6
    violation = column("contact_violation_m_s2")
    waits = switch_to_fresh_ms(schema, rows)
    seconds = (len(rows) + unmeasured) * 1e-3
    return {
        "fell": fell,
        "task_seconds": round(seconds, 3),
        "measured_seconds": round(len(rows) * 1e-3, 3),
        "com_error_m": mean(column("com_error_m")),
        "contact_violation_m_s2": mean(violation),
        "foot_slip_mm": quantiles(stance_slips(schema, rows) * 1e3),
        "switch_to_fresh_ms": {**quantiles(waits), "never": int(np.isnan(waits).sum())},
        "on_board_qps": int(column("on_board_qps")[-1]) if len(rows) else 0,
        "commands": {each.label: int(np.sum(source == each)) for each in Source},
        "projector_age_ms": quantiles(age_ms[age_ms >= 0]),
        "robot_tick_ms": quantiles(column("tick_ns") * 1e-6),
        "tick_lateness_ms": quantiles(column("late_ns") * 1e-6),
        "overruns": int(column("overruns")[-1]) if len(rows) else 0,
        "realtime_factor": round(seconds / wall_seconds, 4) if wall_seconds > 0 else None,
        "sensor_faults": sensor_faults,
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


def link_report(rows: np.ndarray, *, profile: str, passes: int) -> dict[str, Any]:
    """Return the shim's part, from its message rows: nominal delay, and achieved minus nominal."""
    report: dict[str, Any] = {"profile": profile, "profile_passes": passes, "link": {}}
    directions = LINK_SCHEMA.column(rows, "direction")
    for k, name in enumerate(DIRECTIONS):
        way = rows[directions == k]
        nominal = LINK_SCHEMA.column(way, "nominal_ns")
        achieved = LINK_SCHEMA.column(way, "achieved_ns")
        passed = achieved >= 0
        sent_ns = LINK_SCHEMA.column(rows, "wall_ns")
        seconds = float(np.ptp(sent_ns)) * 1e-9 if len(rows) else 0.0
        n_bytes = float(LINK_SCHEMA.column(way, "bytes").sum())
        report["link"][name] = {
            "bytes_per_second": round(n_bytes / seconds, 1) if seconds > 0.0 else None,
            "dropped_by_profile": int(np.sum(~passed)),
            "bytes_per_message": quantiles(LINK_SCHEMA.column(way, "bytes")),
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
    return _discrepancy(cardinality, *(schema.column(rows, name) for name in _ERRORS))


def _discrepancy(cardinality: np.ndarray, *errors: np.ndarray) -> dict[str, Any]:
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


def summary(
    config: RunConfig,
    *,
    robot: dict[str, Any],
    edge: dict[str, Any] | None,
    link: dict[str, Any] | None,
    discrepancy: dict[str, Any] | None,
) -> dict[str, Any]:
    """Return the summary of a run. It has every key, even if a part is missing."""
    unknown = {"sent": None, "received": None, "lost": None, "refused": None}
    skeleton = {
        "task": config.task,
        "controller": config.controller,
        "network": config.link.network,
        "seed": config.seed,
        "edge_solve_ms": quantiles(np.empty(0)),
        "active_set_discrepancy": discrepancy or _discrepancy(*[np.empty(0)] * 3),
        "link": {
            name: {**unknown, "bytes_per_second": None, "delay_error_ms": quantiles(np.empty(0))}
            for name in DIRECTIONS
        },
    }
    return {**merge(skeleton, robot, edge, link), "versions": versions()}


def summary_in_words(summary: dict[str, Any]) -> str:
    """Return the summary as text for a person."""
    age, tick, solve = (
        summary[key] for key in ("projector_age_ms", "robot_tick_ms", "edge_solve_ms")
    )
    task = TASKS.label(summary["task"])
    controller = CONTROLLERS.label(summary["controller"])
    ended = {True: "FELL", False: "Stands", None: "Killed"}[summary["fell"]]
    lines = [
        f"{ended} after {summary['task_seconds']:.2f} s of "
        f"{task} with {controller} over {summary['network']}",
        "  CoM error and contact violation have no meaning after a fall"
        if summary["fell"]
        else f"  CoM error {_number(summary['com_error_m'], 'cm', 100)}, contact violation "
        f"{_number(summary['contact_violation_m_s2'], 'm/s²', digits=3)}",
        "  commands "
        + ", ".join(f"{count} {name}" for name, count in summary["commands"].items())
        + f"; projector age p50 {_number(age['p50'], 'ms')}, p99 {_number(age['p99'], 'ms')}, "
        f"max {_number(age['max'], 'ms')}",
    ]
    if summary["measured_seconds"] < summary["task_seconds"]:
        lines.insert(1, f"  figures cover its first {summary['measured_seconds']:.2f} s")
    slip, wait = summary["foot_slip_mm"], summary["switch_to_fresh_ms"]
    discrepancy = summary["active_set_discrepancy"]
    differs = (
        []
        if discrepancy["mean"] is None
        else [
            f"active set differs in {_number(discrepancy['mean'], 'rows')} on average, at most "
            f"{_number(discrepancy['max'], 'rows', digits=0)}"
        ]
    )
    slid = f"foot slip at most {_number(slip['max'], 'mm')} in a stance"
    if facts := [*([] if summary["fell"] else [slid]), *differs]:
        lines.append(f"  {'; '.join(facts)}")
    if summary["task"] == "walk":
        # A controller that corrects needs no fresh projector at a contact switch.
        waited = (
            ""
            if corrects(summary["controller"])
            else f"contact switch to first fresh projector p50 {_number(wait['p50'], 'ms')}, max "
            f"{_number(wait['max'], 'ms')}, not in time {wait['never']} ×; "
        )
        lines.append(f"  {waited}{summary['on_board_qps']} QPs solved on board")
    for name, way in summary["link"].items():
        refused = sum((way["refused"] or {}).values())
        error = way["delay_error_ms"]
        lines.append(
            f"  {name}: {_known(way['sent'])} sent, {_known(way['received'])} received, "
            f"{_known(way['lost'])} lost, "
            f"{refused} refused{_rate(way['bytes_per_second'])}; delay error p50 "
            f"{_number(error['p50'], 'ms')}, p99 {_number(error['p99'], 'ms')}"
        )
    answers = summary["link"]["downlink"].get("answers") or {}
    if len(answers) > 1:
        by_edge = ", ".join(
            f"{counts['taken']} of {edge} ({counts['refused']} refused)"
            for edge, counts in answers.items()
        )
        lines.append(f"  answers from {len(answers)} edges: {by_edge}")
    if faults := summary.get("sensor_faults"):
        held = ", ".join(f"{sensor} {count} ×" for sensor, count in faults.items())
        lines.append(f"  sensor faults held over: {held}")
    lines += [
        f"  robot tick p50 {_number(tick['p50'], 'ms')}, p99 {_number(tick['p99'], 'ms')}; "
        f"edge solve p50 {_number(solve['p50'], 'ms')}, p99 {_number(solve['p99'], 'ms')}",
        f"  overruns {summary['overruns']}; {_known(summary['realtime_factor'])} × real time",
    ]
    return "\n".join(lines)


def _known(value: float | None) -> str:
    return "-" if value is None else str(value)


def _rate(bytes_per_second: float | None) -> str:
    return "" if bytes_per_second is None else f", {bytes_per_second / 1e6:.3f} MB/s"


def _number(value: float | None, unit: str, scale: float = 1.0, *, digits: int = 2) -> str:
    return "-" if value is None else f"{value * scale:.{digits}f} {unit}"
