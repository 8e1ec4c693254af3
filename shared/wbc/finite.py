"""Check for finite numbers, in one call if they are finite."""

from __future__ import annotations

import math

import numpy as np


def all_finite(numbers: np.ndarray) -> bool:
    """Return whether real `numbers`, of any contiguous shape, hold no NaN and no infinity.

    A finite sum of squares has finite terms only. An overflowing sum tells nothing about its terms.
    """
    # Unlike `dot` it does not warn of an overflow.
    return math.isfinite(np.vdot(numbers, numbers)) or bool(np.isfinite(numbers).all())
