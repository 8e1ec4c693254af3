"""The states that a robot can be in. Others are faults of a sensor or of a message.

A fall may leave these limits, but not at a jump: `Sessions` lets a state pass to which the states
before it lead.
"""

from __future__ import annotations

import numpy as np

from shared.errors import MessageRefused
from shared.robots import Robot

# Beyond the range of the URDF [rad]. A falling robot without joint stops is up to 1.4 rad beyond.
_MARGIN = 0.5 * np.pi
# Speeds [rad/s, m/s]. A falling robot has less than a tenth.
_FASTEST_JOINT, _FASTEST_TURN, _FASTEST_BASE = 100.0, 50.0, 20.0
# Of the height of the base when standing, up or down from there.
_HEIGHTS = 1.5
_UNIT = 1e-3


class StateLimits:
    """The limits of one robot, wide enough for noise and for a fall."""

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._lowest = model.lowerPositionLimit[7:] - _MARGIN
        self._highest = model.upperPositionLimit[7:] + _MARGIN
        self._names = model.names[2:]
        self._height = float(robot.q_standing[2])
        # A box within the limits of q and v: a state inside needs no other comparison.
        low, high = np.full(model.nq + model.nv, -np.inf), np.full(model.nq + model.nv, np.inf)
        low[2], high[2] = (1.0 - _HEIGHTS) * self._height, (1.0 + _HEIGHTS) * self._height
        low[7 : model.nq], high[7 : model.nq] = self._lowest, self._highest
        fastest = np.full(model.nv, _FASTEST_JOINT)
        fastest[:3], fastest[3:6] = _FASTEST_BASE / 3**0.5, _FASTEST_TURN / 3**0.5
        low[model.nq :], high[model.nq :] = -fastest, fastest
        self._low, self._high = low, high

    def check(self, q: np.ndarray, v: np.ndarray) -> None:
        """Raise `MessageRefused` if no robot of this kind can be at q (nq,) and move by v (nv,)."""
        state = np.concatenate((q, v))
        turn = q[3:7]
        if abs(float(turn.dot(turn)) - 1.0) > _UNIT:
            raise MessageRefused("limits", "the base's quaternion is not of unit length")
        if bool(((state >= self._low) & (state <= self._high)).all()):
            return
        joints, rates = q[7:], v[6:]
        outside = (joints < self._lowest) | (joints > self._highest)
        if outside.any():
            self._refuse(outside, joints, "rad")
        fast = np.abs(rates) > _FASTEST_JOINT
        if fast.any():
            self._refuse(fast, rates, "rad/s")
        if abs(float(q[2]) - self._height) > _HEIGHTS * self._height:
            raise MessageRefused("limits", f"the base is at {q[2]:.3g} m")
        for part, fastest, unit in (
            (v[:3], _FASTEST_BASE, "m/s"),
            (v[3:6], _FASTEST_TURN, "rad/s"),
        ):
            if part.dot(part) > fastest**2:
                raise MessageRefused("limits", f"the base moves by {np.abs(part).max():.3g} {unit}")

    def _refuse(self, wrong: np.ndarray, values: np.ndarray, unit: str) -> None:
        joint = int(np.argmax(wrong))
        raise MessageRefused("limits", f"{self._names[joint]} at {values[joint]:.3g} {unit}")
