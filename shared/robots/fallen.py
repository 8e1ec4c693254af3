"""The rule by which a robot counts as fallen, for the robot and for its viewers."""

from __future__ import annotations

import math

import numpy as np

# A fallen robot: CoM below this fraction of its standing height, or the base tilted beyond this
# angle [rad].
FALLEN_COM_HEIGHT = 0.6
FALLEN_TILT = 1.0
# The height of the CoM over a sole with which laws compute for a robot that has fallen, at least
# [m].
LEAST_COM_HEIGHT = 0.1


def has_fallen(q: np.ndarray, *, com_height: float, standing_com_height: float) -> bool:
    """Return whether the robot at the true configuration q has fallen."""
    x, y = q[3:5].tolist()
    # The vertical in the base frame, of which this is the vertical part, from the quaternion.
    upright = 1.0 - 2.0 * (x * x + y * y) > math.cos(FALLEN_TILT)
    high = com_height > FALLEN_COM_HEIGHT * standing_com_height
    # Written so that a state that is not a number counts as fallen.
    return not (upright and high)
