"""The swing foot between two footprints: quintic in the plane and in heading, a bump in height.

Between footprints of different heights another quintic is added to the bump. A foot goes up in the
first part of its swing and down in the last one, so that it passes above the edge of a stair.
"""

from __future__ import annotations

import math

import numpy as np

from shared.motion.footprint import Footprint
from shared.wbc.reference import SwingState

# Part of a swing in which the height changes from one footprint's to the other's.
_CLIMB = 0.4


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
    """State `time` [s] after lift-off of a swing of `duration` [s].

    Halfway it is `height` [m] above the higher footprint.
    """
    u, rate = time / duration, 1.0 / duration
    s, ds, dds = quintic(u)
    z, dz, ddz = bump(u)
    x, y, climb = goal.x - start.x, goal.y - start.y, goal.z - start.z
    up, dup, ddup = quintic((u if climb > 0.0 else u - 1.0 + _CLIMB) / _CLIMB)
    dup, ddup = dup * rate / _CLIMB, ddup * (rate / _CLIMB) ** 2
    turn = math.atan2(math.sin(goal.yaw - start.yaw), math.cos(goal.yaw - start.yaw))
    ds, dds = ds * rate, dds * rate**2
    position, velocity, acceleration = np.array(
        (
            (start.x + s * x, start.y + s * y, start.z + climb * up + height * z),
            (ds * x, ds * y, climb * dup + height * dz * rate),
            (dds * x, dds * y, climb * ddup + height * ddz * rate**2),
        )
    )
    return SwingState(position, velocity, acceleration, start.yaw + s * turn, ds * turn, dds * turn)
