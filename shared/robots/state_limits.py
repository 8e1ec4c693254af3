"""The states that a robot can be in. Others are faults of a sensor or of a message.

A fall may leave these limits gradually, so a state to which the earlier states lead is no fault.
"""

from __future__ import annotations

import numpy as np

from shared.errors import MessageRefused
from shared.robots.description import Robot

# Beyond the range of the URDF [rad]. A falling robot without joint stops is up to 1.4 rad beyond.
_MARGIN = 0.5 * np.pi
# Speeds [rad/s, m/s]. A falling robot has less than a tenth.
_FASTEST_JOINT, _FASTEST_TURN, _FASTEST_BASE = 100.0, 50.0, 20.0
# The largest change of the base's height, as a part of its height in standing.
_HEIGHTS = 1.5
_UNIT = 1e-3


class StateLimits:
    """The limits of one robot, wide enough for noise and for a fall."""

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._names = model.names[2:]
        # Bounds of (q, v). If all components of the base's velocity are within these, its speed
        # needs no further check.
        low, high = np.full(model.nq + model.nv, -np.inf), np.full(model.nq + model.nv, np.inf)
        height = float(robot.q_standing[2])
        low[2], high[2] = (1.0 - _HEIGHTS) * height, (1.0 + _HEIGHTS) * height
        low[7 : model.nq] = model.lowerPositionLimit[7:] - _MARGIN
        high[7 : model.nq] = model.upperPositionLimit[7:] + _MARGIN
        fastest = np.full(model.nv, _FASTEST_JOINT)
        fastest[:3], fastest[3:6] = _FASTEST_BASE / 3**0.5, _FASTEST_TURN / 3**0.5
        low[model.nq :], high[model.nq :] = -fastest, fastest
        self._low, self._high = low, high

    def possible(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return whether the base and each joint can be at q (nq,) and move by v (nv,).

        Truth values (1 + n_joints,). A value that is NaN is false.
        """
        state = np.concatenate((q, v))
        within = (self._low <= state) & (state <= self._high)
        positions, rates = within[: len(q)], within[len(q) :]
        possible = np.empty(len(q) - 6, dtype=bool)
        possible[0] = _is_unit(q[3:7]) and positions[:7].all() and rates[:6].all()
        possible[1:] = positions[7:] & rates[6:]
        return possible

    def check(self, q: np.ndarray, v: np.ndarray) -> None:
        """Raise `MessageRefused` if no robot of this kind can be at q (nq,) and move by v (nv,)."""
        if not _is_unit(q[3:7]):
            raise MessageRefused("limits", "the base's quaternion is not of unit length")
        state = np.concatenate((q, v))
        outside = (state < self._low) | (state > self._high)
        if not outside.any():
            return
        if outside[2]:
            raise MessageRefused("limits", f"the base is at {q[2]:.3g} m")
        joints, rates = slice(7, len(q)), slice(len(q) + 6, None)
        for block, unit in ((joints, "rad"), (rates, "rad/s")):
            if outside[block].any():
                joint = int(np.argmax(outside[block]))
                raise MessageRefused(
                    "limits", f"{self._names[joint]} at {state[block][joint]:.3g} {unit}"
                )
        for part, fastest, unit in (
            (v[:3], _FASTEST_BASE, "m/s"),
            (v[3:6], _FASTEST_TURN, "rad/s"),
        ):
            if part.dot(part) > fastest**2:
                raise MessageRefused("limits", f"the base moves by {np.abs(part).max():.3g} {unit}")


def _is_unit(quaternion: np.ndarray) -> bool:
    return bool(abs(quaternion.dot(quaternion) - 1.0) <= _UNIT)
