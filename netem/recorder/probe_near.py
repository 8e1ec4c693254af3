"""The near end of a recording, without bus, clock or thread.

Each end sends on a schedule that does not depend on arrivals, so that each way is sampled evenly.
The near end records the messages that it sends and receives. The far end reports its arrivals in
the messages down, and repeats each report until it is acknowledged. After the measurement both ends
exchange small messages (*draining*) until nothing is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from netem.recorder.clock_offset import MAX_DRIFT, NEVER, Stamps
from netem.recorder.probe import (
    REPORTS,
    DownProbe,
    Instant,
    ProbeSettings,
    UpProbe,
    decode_down,
    encode_up,
)
from shared.bus.base import RefusalCounter
from shared.errors import MessageRefused

# Larger than any difference of two clocks.
_NONE_NS = 2**62


@dataclass(frozen=True)
class Progress:
    """Newest delays [ns], with clocks aligned by the least delays so far, and losses so far."""

    uplink_ns: int
    downlink_ns: int
    uplink_lost: int
    downlink_lost: int


class NearEnd:
    """The end that writes the profile. It stores at most `capacity` messages each way."""

    def __init__(self, settings: ProbeSettings, *, session: int, capacity: int) -> None:
        self.settings = settings
        self.session = session
        self.draining = False
        self.one_clock = False
        self.refused = RefusalCounter()
        self.other_version = ""
        # Time of the last new stamp, on the monotonic clock.
        self.last_news_ns = 0
        self._up = np.full((2, capacity), NEVER, dtype=np.int64)
        self._down = np.full((2, capacity), NEVER, dtype=np.int64)
        self._sent = 0
        self._reported = 0
        self._reported_end = 0
        self._acknowledged = 0
        self._received = 0
        self._received_end = 0
        self._far_sent: int | None = None
        # Newest and least difference of stamps each way (delay plus or minus the clocks' offset),
        # and the time of the last one. The least difference grows as fast as clocks may drift.
        self._newest, self._least = [0, 0], [_NONE_NS, _NONE_NS]
        self._noted_ns = [0, 0]

    @property
    def answered(self) -> bool:
        """Return whether messages have passed both ways."""
        return self._reported > 0

    @property
    def drained(self) -> bool:
        """Return whether the far end has confirmed the end of the measurement."""
        return self._far_sent is not None

    @property
    def complete(self) -> bool:
        """Return whether the near end knows that every message arrived, both ways."""
        return self._reported == self._sent and self._received == self._far_sent

    def message(self, now: Instant) -> bytes:
        """The message to send now."""
        sent_ns = now.stamp_ns(self.settings)
        sequence = self._sent
        if not self.draining:
            self._up[0, sequence] = sent_ns
            self._sent += 1
        probe = UpProbe(
            *(self.session, sequence, sent_ns, self.draining, self._acknowledged, self.settings)
        )
        return encode_up(probe, size=0 if self.draining else self.settings.uplink_bytes)

    def take(self, data: bytes, now: Instant, *, one_clock: bool) -> None:
        """Take an arriving message; `one_clock`: its sender reads this machine's clock."""
        try:
            probe = decode_down(data)
        except MessageRefused as refusal:
            if refusal.reason == "version":
                self.other_version = str(refusal)
            self.refused[refusal.reason] += 1
            return
        if probe.session != self.session:
            self.refused["session"] += 1
            return
        self.one_clock = one_clock
        if probe.draining:
            self._far_sent = probe.sequence
        else:
            self._take_stamps(probe, now)
        self._take_reports(probe, now)

    def _take_stamps(self, probe: DownProbe, now: Instant) -> None:
        sequence, received_ns = probe.sequence, now.stamp_ns(self.settings)
        if sequence >= self._down.shape[1]:
            self.refused["sequence"] += 1
            return
        if self._down[1, sequence] != NEVER:
            self.refused["duplicate"] += 1
            return
        self._down[:, sequence] = probe.sent_ns, received_ns
        self._note(1, received_ns - probe.sent_ns, now)
        self._received += 1
        self._received_end = max(self._received_end, sequence + 1)
        self.last_news_ns = now.monotonic_ns

    def _take_reports(self, probe: DownProbe, now: Instant) -> None:
        reports = np.frombuffer(probe.reports, REPORTS)
        end = probe.first_report + len(reports)
        # Reports are repeated until they are acknowledged. The acknowledged ones are known.
        reports = reports[max(0, self._acknowledged - probe.first_report) :]
        sent_ns, received_ns = self._up
        for sequence, stamp_ns in reports.tolist():
            if sequence >= self._sent:
                self.refused["reports"] += 1
                return
            # The first of two arrivals of one message counts.
            if received_ns[sequence] == NEVER:
                received_ns[sequence] = stamp_ns
                self._note(0, stamp_ns - int(sent_ns[sequence]), now)
                self._reported += 1
                self._reported_end = max(self._reported_end, sequence + 1)
                self.last_news_ns = now.monotonic_ns
        if probe.first_report <= self._acknowledged:
            self._acknowledged = max(self._acknowledged, end)

    def _note(self, way: int, newest_ns: int, now: Instant) -> None:
        forgotten_ns = round(MAX_DRIFT * (now.monotonic_ns - self._noted_ns[way]))
        self._newest[way] = newest_ns
        self._least[way] = min(self._least[way] + forgotten_ns, newest_ns)
        self._noted_ns[way] = now.monotonic_ns

    @property
    def progress(self) -> Progress:
        """The delays and losses so far, for the status line."""
        offset_ns = 0
        if not self.one_clock and not self.settings.synchronised:
            offset_ns = (self._least[0] - self._least[1]) // 2
        return Progress(
            uplink_ns=self._newest[0] - offset_ns,
            downlink_ns=self._newest[1] + offset_ns,
            uplink_lost=self._reported_end - self._reported,
            downlink_lost=self._received_end - self._received,
        )

    def stamps(self) -> tuple[Stamps, Stamps]:
        """All known stamps, up and down."""
        far_sent = self._received_end if self._far_sent is None else self._far_sent
        end = max(far_sent, self._received_end)
        up, down = self._up[:, : self._sent], self._down[:, :end]
        return Stamps(up[0].copy(), up[1].copy()), Stamps(down[0].copy(), down[1].copy())
