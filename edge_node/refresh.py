"""Schedule of a locally corrected robot's factorisations: it lacks one, or has moved away from it.

Each state names the factorisations that the robot holds. The edge therefore replaces a lost one,
and serves a robot that has just joined or come back, without a handshake. After a while without a
factorisation to send, an empty answer shows that the edge runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from shared.config.control_settings import CorrectionConfig
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Motion
from shared.wire.messages import RobotState

# The maximum number of doublings of the wait.
_MAX_DOUBLINGS = 4


@dataclass(frozen=True, slots=True)
class _Sent:
    sequence: int
    stamp_ns: int
    posture: np.ndarray
    tries: int = 1
    arrived: bool = False


class FactorisationRefresh:
    """Remembers the factorisations sent to one start of a robot."""

    def __init__(self, config: CorrectionConfig, motion: Motion) -> None:
        self._config = config
        self._motion = motion
        self._answered_ns = self._round_trip_ns = 0
        self._sent: dict[ContactMode, _Sent] = {}

    def due(
        self, state: RobotState, held_sequences: tuple[int, ...], *, posture: np.ndarray
    ) -> tuple[ContactMode, ...] | None:
        """Contact modes to factorise now that the joints are at `posture` (nv − 6,) [rad].

        None if no answer is due at all.
        """
        self._note_arrivals(state, held_sequences)
        # A robot that decides on its steps may lift any foot next.
        needed = set(ContactMode) if state.steps else {state.mode, self._next_mode(state)}
        modes = tuple(mode for mode in ContactMode if self._is_due(mode, state, needed, posture))
        silent = state.stamp_ns - self._answered_ns >= self._config.retry_ns
        return modes if modes or silent else None

    def sent(
        self, state: RobotState, modes: tuple[ContactMode, ...], *, posture: np.ndarray
    ) -> None:
        """Remember that these modes were factorised at `posture` and sent as answer to a state."""
        self._answered_ns = state.stamp_ns
        for mode in modes:
            before = self._sent.get(mode)
            tries = 1 if before is None or before.arrived else before.tries + 1
            self._sent[mode] = _Sent(state.sequence, state.stamp_ns, posture.copy(), tries)

    def _note_arrivals(self, state: RobotState, held_sequences: tuple[int, ...]) -> None:
        for mode, sent in self._sent.items():
            holds = held_sequences[mode] >= sent.sequence
            if holds and not sent.arrived:
                self._round_trip_ns = state.stamp_ns - sent.stamp_ns
            # A robot whose controller was replaced lacks what it held before.
            if holds is not sent.arrived:
                self._sent[mode] = replace(sent, arrived=holds)

    def _is_due(
        self,
        mode: ContactMode,
        state: RobotState,
        needed: set[ContactMode],
        posture: np.ndarray,
    ) -> bool:
        sent = self._sent.get(mode)
        if sent is None:
            return True
        elapsed_ns = state.stamp_ns - sent.stamp_ns
        if not sent.arrived and elapsed_ns >= self._retry_after_ns(sent):
            return True
        if mode not in needed or elapsed_ns < self._config.refresh_interval_ns:
            return False
        moved = posture - sent.posture
        return math.sqrt(moved.dot(moved) / len(moved)) > self._config.refresh_distance

    def _retry_after_ns(self, sent: _Sent) -> float:
        """Time before the next try [ns]: doubled with every try up to a limit, at least 1.2 round
        trips.
        """
        backoff: float = 2 ** min(sent.tries - 1, _MAX_DOUBLINGS)
        return max(self._config.retry_ns * backoff, 1.2 * self._round_trip_ns)

    def _next_mode(self, state: RobotState) -> ContactMode:
        switch_ns = self._motion.next_switch(state.time_ns)
        return state.mode if switch_ns is None else self._motion.reference(switch_ns).mode
