"""The recorder's messages: a fixed head, reports, and padding to the size of the stack's own.

Up and down have one number each per message sent, the sender's clock, and what the other end has to
know: up, how the far end shall send and how many reports have come home; down, reports of messages
up with the time they arrived. Little-endian; `docs/recording.md` has the fields.
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
# All of a message down that says anything.
DOWN_BYTES_READ = HEAD_BYTES + MAX_REPORTS * REPORTS.itemsize
# A downlink message that holds fewer reports may not bring them home as fast as they arise.
MIN_BYTES = HEAD_BYTES + 4 * REPORTS.itemsize

# Not compressible, should some part of the path try.
_PADDING = memoryview(np.random.default_rng(0).bytes(MAX_BYTES))


@dataclass(frozen=True)
class ProbeSettings:
    """How both ends send. `synchronised`: stamps are the time of day, which both machines share."""

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
        """On the clock that the recording uses."""
        return self.realtime_ns if settings.synchronised else self.monotonic_ns


@dataclass(frozen=True, slots=True)
class UpProbe:
    """Near to far. `draining`: the measurement is over, only reports are still wanted."""

    session: int
    sequence: int
    sent_ns: int
    draining: bool
    acknowledged: int
    settings: ProbeSettings


@dataclass(frozen=True, slots=True)
class DownProbe:
    """Far to near, for the recording `session`. `reports` are packed `REPORTS`, at most
    `MAX_REPORTS`, from number `first_report` on, in the order of arrival. When `draining`,
    `sequence` is how many messages were sent.
    """

    session: int
    sequence: int
    sent_ns: int
    draining: bool
    first_report: int
    reports: bytes


def encode_up(probe: UpProbe, *, size: int) -> bytes:
    """At least `size` bytes."""
    settings = probe.settings
    head = _UP.pack(
        *(_UP_MAGIC, VERSION, probe.draining, probe.session, probe.sequence, probe.sent_ns),
        *(probe.acknowledged, settings.period_ns, settings.downlink_bytes, settings.synchronised),
    )
    return b"".join((head, _PADDING[: max(0, size - len(head))]))


def decode_up(data: bytes) -> UpProbe:
    """`MessageRefused` with the name of the check that failed."""
    _check_opening(data, _UP_MAGIC, _UP.size)
    _, _, draining, session, sequence, sent_ns, acknowledged, period_ns, downlink, clock = (
        _UP.unpack_from(data)
    )
    if not MIN_PERIOD_NS <= period_ns <= MAX_PERIOD_NS or not MIN_BYTES <= downlink <= MAX_BYTES:
        raise MessageRefused("settings", f"period {period_ns} ns, downlink {downlink} bytes")
    settings = ProbeSettings(period_ns, len(data), downlink, bool(clock))
    return UpProbe(session, sequence, sent_ns, bool(draining), acknowledged, settings)


def encode_down(probe: DownProbe, *, size: int) -> bytes:
    """At least `size` bytes."""
    head = _DOWN.pack(
        *(_DOWN_MAGIC, VERSION, probe.draining, probe.session, probe.sequence, probe.sent_ns),
        *(probe.first_report, len(probe.reports) // REPORTS.itemsize),
    )
    padding = _PADDING[: max(0, size - len(head) - len(probe.reports))]
    return b"".join((head, probe.reports, padding))


def decode_down(data: bytes) -> DownProbe:
    """`MessageRefused` with the name of the check that failed."""
    _check_opening(data, _DOWN_MAGIC, _DOWN.size)
    _, _, draining, session, sequence, sent_ns, first, count = _DOWN.unpack_from(data)
    end = _DOWN.size + count * REPORTS.itemsize
    if count > MAX_REPORTS or len(data) < end:
        raise MessageRefused("reports", f"{count} announced in {len(data)} bytes")
    reports = data[_DOWN.size : end]
    return DownProbe(session, sequence, sent_ns, bool(draining), first, reports)


def pack_report(sequence: int, received_ns: int) -> bytes:
    """One of `REPORTS`: message up number `sequence` arrived then."""
    return _REPORT.pack(sequence, received_ns)


def version_notice() -> bytes:
    """What a far end answers to a recorder of another version; the opening never changes."""
    return _OPENING.pack(_DOWN_MAGIC, VERSION)


def parse_bytes(text: str, *, option: str) -> int:
    """`1000B`, `40kB` or `40000` → bytes."""
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
