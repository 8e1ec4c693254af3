"""Rounding of trials: the versions on which the last bits depend, and tolerances for others.

On x86-64 with AVX2 every process uses one BLAS kernel (`shared.process.native_libraries`). With
the same package versions a trial is then the same to the last bit. On other processors, or with
another kernel or version, sums are rounded differently. The metrics of a standing trial then agree
within `RELATIVE` and `ABSOLUTE`. A trial that falls falls there too, within `FALL_SECONDS`; its
other metrics are not compared. If a trial is close to its limit, rounding alone may decide whether
it stands. `docs/reproduction.md` has measurements.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shared.output.versions import versions
from shared.process.native_libraries import AVX2, KERNEL

RELATIVE, ABSOLUTE, FALL_SECONDS = 1e-3, 1e-6, 0.05
# The names in `shared.output.versions.versions`, and in `about.json`, on which rounding depends.
_DEPENDS_ON = (
    "instructions",
    "blas",
    "numpy",
    "scipy",
    "pin",
    "example-robot-data",
    "mujoco",
    "daqp",
)
# Sweeps from before these were recorded ran on processors with AVX2 and a kernel that rounds like
# `KERNEL`.
_UNRECORDED = {"instructions": AVX2, "blas": KERNEL}
# Columns of a row: the duration, the fall, and the hash of the telemetry.
_DURATION, _FELL, _IDENTITY = "task_seconds", "fell", "log_hash"

Row = Mapping[str, Any]


def differences(about: Mapping[str, Any]) -> list[str]:
    """Reasons why trials with this `about.json` may differ here in their last bits; [] if none."""
    then, here = _UNRECORDED | about["versions"], versions()
    return [
        f"{name} {then.get(name, 'unknown')} there, {here[name]} here"
        for name in _DEPENDS_ON
        if then.get(name) != here[name]
    ]


def beyond(row: Row, again: Row, names: list[str]) -> list[str]:
    """The columns among `names` in which two rows differ by more than rounding explains."""
    if row.get(_FELL) != again.get(_FELL):
        return [_FELL]
    if row.get(_FELL):
        names = [name for name in names if name == _DURATION]
    tolerance = FALL_SECONDS if row.get(_FELL) else ABSOLUTE
    return [
        name
        for name in names
        if name != _IDENTITY and not _close(row.get(name), again.get(name), tolerance)
    ]


def _close(before: Any, after: Any, tolerance: float) -> bool:
    if isinstance(before, list) and isinstance(after, list):
        pairs = zip(before, after, strict=False)
        return len(before) == len(after) and all(_close(*pair, tolerance) for pair in pairs)
    if isinstance(before, int | float) and isinstance(after, int | float):
        return math.isclose(before, after, rel_tol=RELATIVE, abs_tol=tolerance)
    return bool(before == after)
