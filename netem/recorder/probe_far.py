"""The far end of a recording, without bus, clock or thread.

It sends with the settings of the near end, and reports the messages that arrive. See
`netem.recorder.probe_near` for the protocol.
"""

from __future__ import annotations

from netem.recorder.probe import (
    HEAD_BYTES,
    MAX_REPORTS,
    REPORTS,
    DownProbe,
    Instant,
    UpProbe,
    decode_up,
    encode_down,
    pack_report,
)
from shared.bus.base import RefusalCounter
from shared.errors import MessageRefused

# Reports that wait for an acknowledgement: a quarter of an hour at 1 kHz, 12 MB.
_MAX_WAITING = 1_000_000
# The far end stops sending after this silence, which is longer than any outage of interest.
_PATIENCE_NS = 60_000_000_000
# After this silence another recorder may take over, and a draining near end counts as gone.
_SILENCE_NS = 2_000_000_000


class FarRecording:
    """One recording, which begins with the first message of its near end."""

    def __init__(self, first: UpProbe) -> None:
        self.session = first.session
        self.settings = first.settings
        self.sent = 0
        self.received = 0
        self.unreported = 0
        self.draining = False
        self.heard_ns = 0
        # Packed reports. The first has the number `_first`. The next message begins with `_next`.
        self._reports = bytearray()
        self._first = 0
        self._next = 0

    def take(self, probe: UpProbe, now: Instant) -> None:
        """Take a message of this recording."""
        self.heard_ns = now.monotonic_ns
        if probe.draining:
            self.draining = True
        elif len(self._reports) < _MAX_WAITING * REPORTS.itemsize:
            self._reports += pack_report(probe.sequence, now.stamp_ns(self.settings))
            self.received += 1
        else:
            self.unreported += 1
        done = (probe.acknowledged - self._first) * REPORTS.itemsize
        if 0 < done <= len(self._reports):
            del self._reports[:done]
            self._first = probe.acknowledged

    def message(self, now: Instant) -> bytes:
        """The message to send now."""
        size = HEAD_BYTES if self.draining else self.settings.downlink_bytes
        room = MAX_REPORTS
        if not self.draining:
            room = min(room, (size - HEAD_BYTES) // REPORTS.itemsize)
        end = self._first + len(self._reports) // REPORTS.itemsize
        # Continue after the last message. At the end, repeat all unacknowledged reports.
        first = self._next if self._first <= self._next < end else self._first
        self._next = min(end, first + room)
        begin, stop = ((number - self._first) * REPORTS.itemsize for number in (first, self._next))
        probe = DownProbe(
            session=self.session,
            sequence=self.sent,
            sent_ns=now.stamp_ns(self.settings),
            draining=self.draining,
            first_report=first,
            reports=bytes(self._reports[begin:stop]),
        )
        self.sent += not self.draining
        return encode_down(probe, size=size)

    def over(self, now: Instant) -> bool:
        """Return whether the near end counts as gone."""
        return self.silence_ns(now) > (_SILENCE_NS if self.draining else _PATIENCE_NS)

    def silence_ns(self, now: Instant) -> int:
        """The time since the last message of the near end [ns]."""
        return now.monotonic_ns - self.heard_ns


class FarEnd:
    """The far end, which serves one recording at a time."""

    def __init__(self) -> None:
        self.recording: FarRecording | None = None
        self.refused = RefusalCounter()
        # A recorder of another version waits for the notice of our version.
        self.owes_version = False
        self._ended = -1

    def take(self, data: bytes, now: Instant) -> None:
        """Take an arriving message."""
        try:
            probe = decode_up(data)
            if self.recording is None or probe.session != self.recording.session:
                self._begin(probe, now)
        except MessageRefused as refusal:
            self.owes_version |= refusal.reason == "version"
            self.refused[refusal.reason] += 1
            return
        assert self.recording is not None
        self.recording.take(probe, now)

    def end(self) -> FarRecording | None:
        """End the present recording. Return it."""
        recording, self.recording = self.recording, None
        if recording is not None:
            self._ended = recording.session
        return recording

    def _begin(self, probe: UpProbe, now: Instant) -> None:
        if probe.session == self._ended or probe.draining:
            raise MessageRefused("late", "its recording is over")
        if self.recording is not None and self.recording.silence_ns(now) < _SILENCE_NS:
            raise MessageRefused("busy", "another recording is under way")
        self.recording = FarRecording(probe)
