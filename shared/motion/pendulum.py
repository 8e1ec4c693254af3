"""The linear inverted pendulum over a centre of pressure (CoP) that stays.

The divergent component of motion (DCM) ξ = c + ċ/ω leaves the CoP p. After a time T

    ξ_T = p + (ξ − p) e^{ωT}.

A negative T goes back in time. After Englsberger, Ott & Albu-Schäffer 2015.
"""

from __future__ import annotations

import numpy as np


def dcm_of(com: np.ndarray, velocity: np.ndarray, *, omega: float) -> np.ndarray:
    """Return the DCM [m] of a CoM [m] with a velocity [m/s]; `omega` is ω [1/s]."""
    dcm: np.ndarray = com + velocity / omega
    return dcm


def moved_dcm(dcm: np.ndarray, *, cop: np.ndarray, growth: float | np.ndarray) -> np.ndarray:
    """Return the DCM [m] after a time T, with `growth` = e^{ωT}. The arrays are broadcast."""
    moved: np.ndarray = cop + (dcm - cop) * growth
    return moved
