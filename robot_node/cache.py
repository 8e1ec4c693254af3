"""The newest answer of the edge, and why the others were refused.

An answer is taken if it passes the codec, echoes this start of the robot, and was computed from a
newer state than the one held. Each contact mode keeps its own projector: one of another mode is
never applied.
"""

from __future__ import annotations

from dataclasses import dataclass

from shared.bus.base import RefusalCounter
from shared.errors import MessageRefused
from shared.wbc.contacts import ContactMode
from shared.wbc.projector import Projector
from shared.wire.codec import Codec
from shared.wire.messages import ProjectorMessage, TimedProjector


@dataclass(frozen=True, slots=True)
class CacheEntry:
    """A projector with the message it came in."""

    timed: TimedProjector
    message: ProjectorMessage

    @property
    def projector(self) -> Projector:
        return self.timed.projector


class ProjectorCache:
    """Newest projector per contact mode."""

    def __init__(self, codec: Codec, *, session: int) -> None:
        self.refused = RefusalCounter()
        self.newest_stamp_ns = 0
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
        for timed in message.projectors:
            self._entries[timed.projector.mode] = CacheEntry(timed, message)
        self.newest_stamp_ns = message.stamp_ns
        return True

    def lookup(self, mode: ContactMode, *, time_ns: int) -> CacheEntry | None:
        """The newest projector of a mode that may be used at a task time, or None."""
        entry = self._entries.get(mode)
        if entry is None:
            return None
        if not entry.timed.valid_from_ns <= time_ns <= entry.timed.valid_until_ns:
            return None
        return entry
