"""The states that the robot has sent, as far as an answer may still echo one.

An answer names the state that it was computed from. The robot's own record of that state decides
the age of the answer, and whether its content is right. An echoed time decides nothing.
"""

from __future__ import annotations

import numpy as np

# Ticks: 65 s. An answer to an older state is stale.
_REMEMBERED = 2**16
# Ticks with the whole state: 1 s.
_WHOLE = 2**10


class SentStates:
    """Times and joint positions of the states sent last, by their sequence."""

    def __init__(self, n_joints: int) -> None:
        self.newest = -1
        self._stamps_ns = [0] * _REMEMBERED
        self._postures = np.zeros((_REMEMBERED, n_joints), np.float32)
        self._states: list[tuple[np.ndarray, np.ndarray] | None] = [None] * _WHOLE

    def add(self, sequence: int, *, stamp_ns: int, q: np.ndarray, v: np.ndarray) -> None:
        """Remember a state with the next sequence: its time, q (nq,) and v (nv,)."""
        place = sequence % _REMEMBERED
        self._stamps_ns[place] = stamp_ns
        self._postures[place] = q[7:]
        self._states[sequence % _WHOLE] = (q, v)
        self.newest = sequence

    def stamp_ns(self, sequence: int) -> int | None:
        """Return the time of a state; None if it was not sent or is forgotten."""
        if not max(0, self.newest - _REMEMBERED + 1) <= sequence <= self.newest:
            return None
        return self._stamps_ns[sequence % _REMEMBERED]

    def state(self, sequence: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (q, v) of a state; None if it was not sent or is forgotten."""
        if not max(0, self.newest - _WHOLE + 1) <= sequence <= self.newest:
            return None
        return self._states[sequence % _WHOLE]

    def posture(self, sequence: int) -> np.ndarray:
        """Return the joint positions (nv − 6,) [rad] of a state that is remembered."""
        posture: np.ndarray = self._postures[sequence % _REMEMBERED]
        return posture
