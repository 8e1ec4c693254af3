"""Packets that a table lacks: the numbers of the others skip theirs.

A table of the packets that arrived tells its losses by the numbers of its packets only. A number
that is missing is a lost packet. It was sent between its neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from netem.importers.columns import LOST_NS
from netem.importers.resample import MAX_PERIODS
from shared.errors import ProfileError

_WRAPS = (1 << 8, 1 << 16, 1 << 32)


def unwrapped(numbers: np.ndarray) -> np.ndarray:
    """Numbers in the order of sending, continued where a counter begins again at 0, (n,)."""
    wrap = next((each for each in _WRAPS if numbers.max(initial=0) < each), 0)
    again = np.diff(numbers, prepend=numbers[:1]) < -wrap // 2 if wrap else np.zeros(1, dtype=bool)
    found: np.ndarray = numbers + np.cumsum(again) * wrap
    return found


def skipped(numbers: np.ndarray) -> int:
    """The number of packets missing between the first number and the last."""
    each = np.unique(unwrapped(numbers))
    return int(each[-1] - each[0]) + 1 - len(each) if len(each) else 0


def with_skipped(
    path: Path, numbers: np.ndarray, values: Mapping[str, np.ndarray], interval_ns: int | None
) -> dict[str, np.ndarray]:
    """Add the packets that are missing by their numbers, `LOST_NS` for all but `sent`.

    Of two rows of one number the first counts. Without `sent`, the packets are `interval_ns` apart.
    """
    known, rows = np.unique(unwrapped(numbers), return_index=True)
    first, last = int(known[0]), int(known[-1])
    if last - first >= MAX_PERIODS:
        raise ProfileError(
            f"{path}: expected at most {MAX_PERIODS} packets, got seq {first} to {last}; try "
            "another column"
        )
    every = np.arange(first, last + 1)
    filled = {}
    for key, column in values.items():
        filled[key] = np.full(len(every), LOST_NS)
        filled[key][known - first] = column[rows]
    if "sent" in filled:
        start = int(values["sent"][rows[0]])
        between = np.interp(every, known, values["sent"][rows] - start)
        filled["sent"] = start + np.rint(between).astype(np.int64)
    elif interval_ns is not None:
        filled["sent"] = (every - first) * interval_ns
    return filled
