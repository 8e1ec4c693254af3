"""Reads a recording back: what the tests hold against the rows that went in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader


def entities(recording: Path) -> set[str]:
    """Paths of everything that was logged, with or without a time."""
    return {str(chunk.entity_path) for chunk in RrdReader(recording).stream()}


def logged(
    recording: Path, path: str, component: str, *, timeline: str = "task_time"
) -> tuple[np.ndarray, list[Any]]:
    """Times [ns] of an entity's rows, in order, and the values of one component in each."""
    times, values = [], []
    for chunk in RrdReader(recording).stream():
        if str(chunk.entity_path) != path or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        if component in batch.schema.names:
            times += batch[timeline].cast("int64").to_pylist()
            values += batch[component].to_pylist()
    order = np.argsort(times, kind="stable")
    return np.array(times, dtype=np.int64)[order], [values[k] for k in order]


def static(recording: Path, path: str, component: str) -> list[Any]:
    """Values of a component that has no time."""
    values = []
    for chunk in RrdReader(recording).stream():
        if str(chunk.entity_path) == path and chunk.is_static:
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                values += batch[component].to_pylist()
    return values
