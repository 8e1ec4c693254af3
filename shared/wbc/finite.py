"""Whether numbers are numbers, in one call where they are."""

from __future__ import annotations

import math

import numpy as np


def all_finite(numbers: np.ndarray) -> bool:
    """No NaN and no infinity among real `numbers`, of any shape that is contiguous.

    A finite sum of squares has finite terms only. One that overflows says nothing of them.
    """
    # Unlike `dot` it does not warn of an overflow.
    return math.isfinite(np.vdot(numbers, numbers)) or bool(np.isfinite(numbers).all())
