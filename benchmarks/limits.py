"""Cost of the robot's own limits: ticks with them, as ratios to ticks without.

Robots with and without limits stand side by side in one process. Each has an edge that answers
every state at once. The robots play batches of ticks in turn. A tick's time is that of measuring,
receiving and commanding, as in the column `tick_ns`.
"""

from __future__ import annotations

import gc

import numpy as np

from benchmarks.faults.pair import Pair
from benchmarks.timing import Ratio, header
from shared.config.config_file import load_config
from shared.output.text_table import aligned

_CONTROLLERS = ("la", "lc")
_KINDS: tuple[dict[str, bool], ...] = ({}, {"torque": True}, {"torque": True, "position": True})
_BATCH, _WARM_UP = 20, 200


def run(*, rounds: int) -> str:
    """Measure, and return the table as text."""
    top = header()
    lines = [["", "limits", "p50 [ms]", "p50 / none", "p99 / none"]]
    for controller in _CONTROLLERS:
        batches = _batches(controller, rounds=rounds)
        for kind, ours in zip(_KINDS, batches, strict=True):
            ratio = Ratio.of(ours, batches[0])
            p50 = float(np.median(np.concatenate(ours))) * 1e-6
            name = ", ".join(kind) or "none"
            lines.append(
                [controller.upper(), name, f"{p50:.3f}", ratio.p50_text, f"{ratio.p99:.2f}"]
            )
    return "\n".join([f"{top}; {rounds} rounds of {_BATCH} ticks", "", *aligned(lines, left=2)])


def _batches(controller: str, *, rounds: int) -> list[list[np.ndarray]]:
    """Durations of ticks [ns], by kind of limits and round."""
    pairs = [_pair(controller, kind) for kind in _KINDS]
    gc.disable()
    for _ in range(_WARM_UP):
        for pair in pairs:
            pair.tick()
    for _ in range(rounds):
        for pair in pairs:
            for _ in range(_BATCH):
                pair.tick()
    gc.enable()
    measured = [pair.column("tick_ns")[_WARM_UP:].reshape(rounds, _BATCH) for pair in pairs]
    return [list(each) for each in measured]


def _pair(controller: str, kind: dict[str, bool]) -> Pair:
    limits = {f"wbc.limits.{name}": on for name, on in kind.items()}
    return Pair(load_config(None, {"controller": controller, "push": [], **limits}))
