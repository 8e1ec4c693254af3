"""What the last bits of a trial depend on, and what holds where that differs.

On x86-64 with AVX2 every process uses one BLAS kernel (`shared.process.native_libraries`): with
the same package versions a trial is the same to the last bit. On other processors, or with another
kernel or version, sums are rounded otherwise. A trial that stands then agrees within `RELATIVE` and
`ABSOLUTE`. One that falls falls too, within `FALL_SECONDS`; what is measured of a falling robot
is not compared. Where a trial is at its limit, rounding alone may decide whether it stands.
`docs/reproduction.md` has what was measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shared.output.versions import versions
from shared.process.native_libraries import AVX2, KERNEL

RELATIVE, ABSOLUTE, FALL_SECONDS = 1e-3, 1e-6, 0.05
# Of `shared.output.versions.versions`, which a sweep leaves in its `about.json`.
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
# Sweeps from before these were recorded are of processors with AVX2, and of a kernel that rounds
# as ours does.
_UNRECORDED = {"instructions": AVX2, "blas": KERNEL}
# Of a row, as exact as the settings.
_DURATION, _FELL, _IDENTITY = "task_seconds", "fell", "log_hash"

Row = Mapping[str, Any]


def differences(about: Mapping[str, Any]) -> list[str]:
    """Why the bits of the trials in an `about.json` may not be had here; empty if they must be."""
    then, here = _UNRECORDED | about["versions"], versions()
    return [
        f"{name} {then.get(name, 'unknown')} there, {here[name]} here"
        for name in _DEPENDS_ON
        if then.get(name) != here[name]
    ]


def beyond(row: Row, again: Row, names: list[str]) -> list[str]:
    """Those of the columns in which two rows differ by more than rounding explains."""
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
