"""Distinguish a motion from a jump: in a motion, positions change as the velocities say."""

from __future__ import annotations

import math

import numpy as np

# The largest difference of a base without noise [m, and part of a quaternion].
_BASE_JUMP = 0.05


def continues(
    before: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    *,
    seconds: float,
    jump: float,
    base_jump: float = _BASE_JUMP,
) -> np.ndarray:
    """Return whether the base and each joint of q (nq,) follow from the configuration `before`.

    Truth values (1 + n_joints,). A joint may differ by `jump` [rad] from the position to which v
    (nv,) takes it in `seconds`, and the base by `base_jump` [m, part of a quaternion]. A value that
    is NaN is false.
    """
    moved = q - before
    follows = np.empty(len(q) - 6, dtype=bool)
    with np.errstate(invalid="ignore", over="ignore"):
        follows[1:] = np.abs(moved[7:] - seconds * v[6:]) <= jump
    position, quaternion = (_norm(part) for part in (moved[:3], moved[3:7]))
    speed, rate = (seconds * _norm(part) for part in (v[:3], v[3:6]))
    # The chord between the quaternions before and after a turn by an angle.
    chord = 2.0 * abs(math.sin(0.25 * rate)) if math.isfinite(rate) else math.nan
    follows[0] = abs(position - speed) <= base_jump and abs(quaternion - chord) <= base_jump
    return follows


def _norm(part: np.ndarray) -> float:
    return math.sqrt(part.dot(part))
