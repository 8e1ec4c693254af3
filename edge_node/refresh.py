"""When a locally corrected robot gets a factorisation: when it lacks one or has moved away from it.

The robot says with every state what it holds, so what was lost, or a robot that has just joined or
come back, is served without a handshake. When there is nothing to send for a while, an empty answer
says that the edge is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shared.config import CorrectionConfig
from shared.motion.reference import Motion
from shared.wbc.contacts import ContactMode
from shared.wire.messages import RobotState


@dataclass(frozen=True, slots=True)
class _Sent:
    sequence: int
    stamp_ns: int
    posture: np.ndarray


class FactorisationRefresh:
    """Remembers what one robot was sent."""

    def __init__(self, config: CorrectionConfig, motion: Motion) -> None:
        self._config = config
        self._motion = motion
        self._session = -1
        self._answered_ns = 0
        self._sent: dict[ContactMode, _Sent] = {}

    def due(self, state: RobotState, holds: tuple[int, ...]) -> tuple[ContactMode, ...] | None:
        """Contact modes to factorise at this state; None if no answer is due at all."""
        if state.session != self._session:
            self._session = state.session
            self._sent.clear()
        needed = {state.mode, self._next_mode(state)}
        modes = tuple(mode for mode in ContactMode if self._is_due(mode, state, holds, needed))
        silent = state.stamp_ns - self._answered_ns >= self._config.retry_ns
        return modes if modes or silent else None

    def sent(self, state: RobotState, modes: tuple[ContactMode, ...]) -> None:
        """Remember that these modes were factorised at this state and sent."""
        self._answered_ns = state.stamp_ns
        for mode in modes:
            self._sent[mode] = _Sent(state.sequence, state.stamp_ns, state.q[7:].copy())

    def _is_due(
        self,
        mode: ContactMode,
        state: RobotState,
        holds: tuple[int, ...],
        needed: set[ContactMode],
    ) -> bool:
        sent = self._sent.get(mode)
        if sent is None:
            return True
        arrived = holds[mode] >= sent.sequence
        if not arrived and state.stamp_ns - sent.stamp_ns >= self._config.retry_ns:
            return True
        moved = float(np.abs(state.q[7:] - sent.posture).max())
        return mode in needed and moved > self._config.refresh_distance

    def _next_mode(self, state: RobotState) -> ContactMode:
        switch_ns = self._motion.next_switch(state.time_ns)
        return state.mode if switch_ns is None else self._motion.reference(switch_ns).mode
