"""The swing foot between two footprints: quintic in the plane and in heading, a bump in height."""

from __future__ import annotations

import math

import numpy as np

from shared.motion.footprint import Footprint
from shared.wbc.reference import SwingState


def quintic(u: float) -> tuple[float, float, float]:
    """10 u³ − 15 u⁴ + 6 u⁵ on [0, 1] and its derivatives: from 0 to 1, at rest at both ends."""
    u = min(1.0, max(0.0, u))
    return (
        u**3 * (10.0 + u * (-15.0 + 6.0 * u)),
        30.0 * u**2 * (1.0 - u) ** 2,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


def bump(u: float) -> tuple[float, float, float]:
    """64 u³ (1 − u)³ on [0, 1] and its derivatives: 0 to 1 to 0, at rest at both ends."""
    u = min(1.0, max(0.0, u))
    w = u * (1.0 - u)
    dw = 1.0 - 2.0 * u
    return 64.0 * w**3, 192.0 * w**2 * dw, 384.0 * w * (dw * dw - w)


def swing(
    start: Footprint, goal: Footprint, *, time: float, duration: float, height: float
) -> SwingState:
    """State `time` [s] after lift-off of a swing of `duration` [s] that rises `height` [m]."""
    u, rate = time / duration, 1.0 / duration
    s, ds, dds = quintic(u)
    z, dz, ddz = bump(u)
    x, y = goal.x - start.x, goal.y - start.y
    turn = math.atan2(math.sin(goal.yaw - start.yaw), math.cos(goal.yaw - start.yaw))
    ds, dds = ds * rate, dds * rate**2
    position, velocity, acceleration = np.array(
        (
            (start.x + s * x, start.y + s * y, height * z),
            (ds * x, ds * y, height * dz * rate),
            (dds * x, dds * y, height * ddz * rate**2),
        )
    )
    return SwingState(position, velocity, acceleration, start.yaw + s * turn, ds * turn, dds * turn)
