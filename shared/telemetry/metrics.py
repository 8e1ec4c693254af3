"""Metrics of a run, from its telemetry rows.

The robot computes the paper's CoM error and contact violation (Sec. IV-C) in every tick. Metrics
that need more than one row are here.
"""

from __future__ import annotations

import hashlib
import itertools

import numpy as np

from shared.telemetry.row_log import row_chunks
from shared.telemetry.schema import SOLVE_SCHEMA, Schema

_HASHED_COLUMNS = ("time_ns", "source", "q", "v", "tau")


def log_hash(schema: Schema, rows: np.ndarray) -> str:
    """Return the SHA-256 of time, source, state and torque of every tick of the task."""
    digest = hashlib.sha256()
    for chunk in row_chunks(rows):
        for name in _HASHED_COLUMNS:
            digest.update(chunk[:, schema.slices[name]].tobytes())
    return digest.hexdigest()


def mean(values: np.ndarray) -> float | None:
    """Return the mean of the finite values; None if there are none."""
    finite = values[np.isfinite(values)]
    return float(f"{finite.mean():.6g}") if finite.size else None


def largest(values: np.ndarray) -> float | None:
    """Return the largest of the finite values; None if there are none."""
    finite = values[np.isfinite(values)]
    return float(f"{finite.max():.6g}") if finite.size else None


def quantiles(values: np.ndarray, *, digits: int = 4) -> dict[str, float | None]:
    """Return p50, p99 and max of the finite values; None if there are none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(finite, [50, 99])
    return {
        "p50": round(float(p50), digits),
        "p99": round(float(p99), digits),
        "max": round(float(finite.max()), digits),
    }


def stance_slips(schema: Schema, rows: np.ndarray) -> np.ndarray:
    """Return the largest slip of a foot in each of its stances, from its first place [m]."""
    slips = schema.column(rows, "foot_slip_m")
    maxima = []
    for foot in slips.T:
        loaded = np.isfinite(foot)
        edges = np.flatnonzero(np.diff(loaded.astype(int))) + 1
        for stance in np.split(foot, edges):
            if len(stance) and np.isfinite(stance[0]):
                maxima.append(stance.max())
    return np.array(maxima)


def switch_to_fresh_ms(schema: Schema, rows: np.ndarray) -> np.ndarray:
    """Return, for each contact switch, the time to the first command from the new mode [ms].

    This command comes from an answer to a state measured in the new mode. Until then commands come
    from a prepared projector, or from none. NaN if the mode ends before.
    """
    mode, tick = schema.column(rows, "mode"), schema.column(rows, "tick")
    sequence, time_ns = schema.column(rows, "projector_sequence"), schema.column(rows, "time_ns")
    switches = np.flatnonzero(np.diff(mode)) + 1
    waits = []
    for begin, end in itertools.pairwise([*switches, len(rows)]):
        new = np.flatnonzero(sequence[begin:end] >= tick[begin])
        waits.append((time_ns[begin + new[0]] - time_ns[begin]) * 1e-6 if new.size else np.nan)
    return np.array(waits)


def true_active_sets(schema: Schema, rows: np.ndarray, solve_rows: np.ndarray) -> np.ndarray:
    """Return the optimal active set of each tick's state, from the edge's solves; −1 if unknown."""
    found = np.full(len(rows), -1, dtype=np.int64)
    if len(solve_rows) and len(rows):
        states = SOLVE_SCHEMA.column(solve_rows, "state_sequence").astype(np.int64)
        order = np.argsort(states, kind="stable")
        ticks = schema.column(rows, "tick").astype(np.int64)
        at = order[np.searchsorted(states, ticks, sorter=order).clip(max=len(states) - 1)]
        hit = states[at] == ticks
        sets = SOLVE_SCHEMA.column(solve_rows, "active_set").astype(np.int64)
        found[hit] = sets[at[hit]]
    return found


def active_set_discrepancy(schema: Schema, rows: np.ndarray, true_sets: np.ndarray) -> np.ndarray:
    """Return by how many rows the active set in use differs from the true one, in each tick.

    |(𝒜 ∪ 𝒜̂) \\ (𝒜 ∩ 𝒜̂)| of Table VI; NaN if either is unknown. After a contact switch, rows of a
    foot that is no longer loaded count as well.
    """
    used = schema.column(rows, "active_set").astype(np.int64)
    known = (used >= 0) & (true_sets >= 0)
    return np.where(known, np.bitwise_count(used ^ true_sets), np.nan)


def by_cardinality(cardinality: np.ndarray, values: np.ndarray) -> list[float | None]:
    """Return the mean of the finite values at each cardinality from 0 on; None without one."""
    return [mean(values[cardinality == k]) for k in range(len(ticks_by_cardinality(cardinality)))]


def ticks_by_cardinality(cardinality: np.ndarray) -> list[int]:
    """Return the number of ticks of each cardinality from 0 to the largest, without NaN."""
    known = cardinality[np.isfinite(cardinality)].astype(np.int64)
    return [int(count) for count in np.bincount(known)]


def in_task(schema: Schema, rows: np.ndarray) -> np.ndarray:
    """Return the rows from the first tick of the task on, without the wait for the edge."""
    begun = schema.column(rows, "time_ns") >= 0
    return rows[int(np.argmax(begun)) :] if begun.any() else rows[:0]
