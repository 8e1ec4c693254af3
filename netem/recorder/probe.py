"""The recorder's messages: a fixed head, reports, and padding to the size of a stack's messages.

Every message has a sequence number of its direction and the time of sending. A message up also has
the settings for the far end and the number of reports that have arrived. A message down has
reports: numbers of messages up with their times of arrival. The numbers are little-endian.
`docs/recording.md` has the fields.
"""

from __future__ import annotations

import re
import struct
import time
from dataclasses import dataclass

import numpy as np

from shared.errors import ConfigError, MessageRefused

VERSION = 1
MAX_BYTES = 1_000_000
MAX_PERIOD_NS = 100_000_000
MIN_PERIOD_NS = 200_000

_OPENING = struct.Struct("<4sH")
_UP = struct.Struct("<4sHBIIqIIIB")
_DOWN = struct.Struct("<4sHBIIqIH")
_UP_MAGIC, _DOWN_MAGIC = b"WBCu", b"WBCd"
_REPORT = struct.Struct("<Iq")
REPORTS = np.dtype([("sequence", "<u4"), ("received_ns", "<i8")])
HEAD_BYTES = max(_UP.size, _DOWN.size)
MAX_REPORTS = 256
# The part of a message down before its padding.
DOWN_BYTES_READ = HEAD_BYTES + MAX_REPORTS * REPORTS.itemsize
# Messages down with room for fewer reports could fall behind the messages up.
MIN_BYTES = HEAD_BYTES + 4 * REPORTS.itemsize

# Random bytes, which no part of the path can compress.
_PADDING = memoryview(np.random.default_rng(0).bytes(MAX_BYTES))


@dataclass(frozen=True)
class ProbeSettings:
    """Period and sizes of the messages. `synchronised`: both machines share the time of day."""

    period_ns: int
    uplink_bytes: int
    downlink_bytes: int
    synchronised: bool = False


@dataclass(frozen=True, slots=True)
class Instant:
    """One moment on two clocks of a machine."""

    monotonic_ns: int
    realtime_ns: int

    @staticmethod
    def now() -> Instant:
        return Instant(time.monotonic_ns(), time.time_ns())

    def stamp_ns(self, settings: ProbeSettings) -> int:
        """The time on the clock that the recording uses [ns]."""
        return self.realtime_ns if settings.synchronised else self.monotonic_ns


@dataclass(frozen=True, slots=True)
class UpProbe:
    """A message up. `draining`: the measurement is over, and the near end waits for reports."""

    session: int
    sequence: int
    sent_ns: int
    draining: bool
    acknowledged: int
    settings: ProbeSettings


@dataclass(frozen=True, slots=True)
class DownProbe:
    """A message down of the recording `session`.

    `reports` are packed `REPORTS`, at most `MAX_REPORTS`, from number `first_report` on, in the
    order of arrival. When `draining`, `sequence` is the number of messages that were sent.
    """

    session: int
    sequence: int
    sent_ns: int
    draining: bool
    first_report: int
    reports: bytes


def encode_up(probe: UpProbe, *, size: int) -> bytes:
    """Encode a message up, padded to `size` bytes or longer."""
    settings = probe.settings
    head = _UP.pack(
        *(_UP_MAGIC, VERSION, probe.draining, probe.session, probe.sequence, probe.sent_ns),
        *(probe.acknowledged, settings.period_ns, settings.downlink_bytes, settings.synchronised),
    )
    return b"".join((head, _PADDING[: max(0, size - len(head))]))


def decode_up(data: bytes) -> UpProbe:
    """Decode a message up; `MessageRefused` with the name of the check that failed."""
    _check_opening(data, _UP_MAGIC, _UP.size)
    _, _, draining, session, sequence, sent_ns, acknowledged, period_ns, downlink, clock = (
        _UP.unpack_from(data)
    )
    if not MIN_PERIOD_NS <= period_ns <= MAX_PERIOD_NS or not MIN_BYTES <= downlink <= MAX_BYTES:
        raise MessageRefused("settings", f"period {period_ns} ns, downlink {downlink} bytes")
    settings = ProbeSettings(period_ns, len(data), downlink, bool(clock))
    return UpProbe(session, sequence, sent_ns, bool(draining), acknowledged, settings)


def encode_down(probe: DownProbe, *, size: int) -> bytes:
    """Encode a message down, padded to `size` bytes or longer."""
    head = _DOWN.pack(
        *(_DOWN_MAGIC, VERSION, probe.draining, probe.session, probe.sequence, probe.sent_ns),
        *(probe.first_report, len(probe.reports) // REPORTS.itemsize),
    )
    padding = _PADDING[: max(0, size - len(head) - len(probe.reports))]
    return b"".join((head, probe.reports, padding))


def decode_down(data: bytes) -> DownProbe:
    """Decode a message down; `MessageRefused` with the name of the check that failed."""
    _check_opening(data, _DOWN_MAGIC, _DOWN.size)
    _, _, draining, session, sequence, sent_ns, first, count = _DOWN.unpack_from(data)
    end = _DOWN.size + count * REPORTS.itemsize
    if count > MAX_REPORTS or len(data) < end:
        raise MessageRefused("reports", f"{count} announced in {len(data)} bytes")
    reports = data[_DOWN.size : end]
    return DownProbe(session, sequence, sent_ns, bool(draining), first, reports)


def pack_report(sequence: int, received_ns: int) -> bytes:
    """Pack one of `REPORTS`: the message up `sequence` arrived at `received_ns`."""
    return _REPORT.pack(sequence, received_ns)


def version_notice() -> bytes:
    """The far end's answer to a recorder of another version; the opening never changes."""
    return _OPENING.pack(_DOWN_MAGIC, VERSION)


def parse_bytes(text: str, *, option: str) -> int:
    """Parse `1000B`, `40kB` or `40000` to bytes."""
    match = re.fullmatch(r"([0-9]+)\s*(k?)B?", text.strip())
    size = -1 if match is None else int(match[1]) * (1000 if match[2] else 1)
    if not MIN_BYTES <= size <= MAX_BYTES:
        raise ConfigError(
            f"{option}: expected a size from {MIN_BYTES}B to {MAX_BYTES}B as in 1000B or 40kB, "
            f"got {text!r}"
        )
    return size


def _check_opening(data: bytes, magic: bytes, size: int) -> None:
    if len(data) < _OPENING.size or data[:4] != magic:
        raise MessageRefused("stranger", "no message of a recorder")
    version = _OPENING.unpack_from(data)[1]
    if version != VERSION:
        raise MessageRefused("version", f"expected {VERSION}, got {version}")
    if len(data) < size:
        raise MessageRefused("length", f"{len(data)} bytes")
