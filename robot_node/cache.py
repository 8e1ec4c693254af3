"""The newest answer of the edge, and why the others were refused.

An answer is taken if it passes the codec, echoes this start of the robot, and was computed from a
newer state than the one held. Each contact mode keeps its own projector: one of another mode is
never applied.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.bus.base import RefusalCounter
from shared.errors import MessageRefused
from shared.wbc.contacts import ContactMode
from shared.wbc.projector import Projector
from shared.wbc.whole_body import TimedProjector
from shared.wire.codec import Codec


@dataclass(frozen=True, slots=True)
class CacheEntry:
    """A projector, and the state it was computed from: its tick and the robot's clock then.

    `tau` and `y` are the full solution at that state; None for what was solved on board or for
    another contact mode than the state's.
    """

    timed: TimedProjector
    sequence: int
    stamp_ns: int
    on_board: bool = False
    tau: np.ndarray | None = None
    y: np.ndarray | None = None

    @property
    def projector(self) -> Projector:
        return self.timed.projector


class ProjectorCache:
    """Newest projector per contact mode, and the newest full solution of any mode."""

    def __init__(self, codec: Codec, *, session: int) -> None:
        self.refused = RefusalCounter()
        self.newest_stamp_ns = 0
        self.newest_solution: CacheEntry | None = None
        self._codec = codec
        self._session = session
        self._newest_sequence = -1
        self._entries: dict[ContactMode, CacheEntry] = {}

    def offer(self, data: bytes, *, newest_sent: int) -> bool:
        """Take a received message if it is good; `newest_sent` is the last state's sequence."""
        try:
            message = self._codec.decode_projector(data)
            if message.session != self._session:
                raise MessageRefused("session", "answers another start of the robot")
            if message.sequence <= self._newest_sequence:
                raise MessageRefused("stale", f"{message.sequence}")
            if message.sequence > newest_sent:
                raise MessageRefused("future", f"{message.sequence}")
        except MessageRefused as refusal:
            self.refused[refusal.reason] += 1
            return False
        self._newest_sequence = message.sequence
        self.newest_stamp_ns = message.stamp_ns
        for timed in message.projectors:
            entry = CacheEntry(timed, message.sequence, message.stamp_ns)
            if timed.projector.mode is message.mode:
                entry = replace(entry, tau=message.tau, y=message.y)
                self.newest_solution = entry
            self.keep(entry)
        return True

    def keep(self, entry: CacheEntry) -> None:
        """Keep an entry unless one from a newer state is there: the faster answer wins."""
        mode = entry.projector.mode
        held = self._entries.get(mode)
        if held is not None:
            # Of two from the same state the edge's wins.
            same_state = entry.sequence == held.sequence
            if entry.sequence < held.sequence or (same_state and entry.on_board):
                return
        self._entries[mode] = entry

    def lookup(self, mode: ContactMode, *, time_ns: int) -> CacheEntry | None:
        """The newest projector of a mode that may be used at a task time, or None."""
        entry = self._entries.get(mode)
        if entry is None:
            return None
        if not entry.timed.valid_from_ns <= time_ns < entry.timed.valid_until_ns:
            return None
        return entry
