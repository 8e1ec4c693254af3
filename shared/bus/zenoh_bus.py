"""The bus over a network: Zenoh, configured for newest-wins control traffic.

Explicit endpoints only (no multicast, no gossip), so that two processes talk through what stands
between them and through nothing else. Shared memory is off: it would bypass the link. Publishers
send at real-time priority, without batching, and drop rather than wait; only the shim waits, which
lets out hundreds of messages at the end of an outage.
"""

from __future__ import annotations

import json
import re
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import zenoh

from shared.bus.base import Delivery, Envelope, new_session
from shared.errors import LinkError

_ENDPOINT = re.compile(r"(tcp|tls|quic|udp|ws|unixsock-stream)/\S+")


def machine_clock() -> int:
    """A number that names this machine's monotonic clock: equal in two processes of one boot."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except OSError:
        return 0
    return zlib.crc32(boot.encode())


class ZenohBus:
    """One Zenoh session. `LinkError` if an endpoint cannot be used."""

    def __init__(
        self, *, listen: Sequence[str] = (), connect: Sequence[str] = (), mode: str = "peer"
    ) -> None:
        for endpoint in (*listen, *connect):
            if not _ENDPOINT.fullmatch(endpoint):
                raise LinkError(
                    f"endpoint: expected PROTOCOL/HOST:PORT as in tcp/127.0.0.1:7460, "
                    f"got {endpoint!r}"
                )
        config = zenoh.Config()
        for key, value in {
            "mode": mode,
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "listen/timeout_ms": 0,
            "listen/exit_on_failure": True,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
            # The default of two batches per priority loses bursts of 40 kB messages on loopback.
            "transport/link/tx/queue/size/real_time": 16,
            # A slow link should lose messages, not store them up in the kernel.
            "transport/link/tcp/so_sndbuf": 262_144,
        }.items():
            config.insert_json5(key, json.dumps(value))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            where = ", ".join((*listen, *connect))
            raise LinkError(
                f"cannot open {where}: {_cause(error)}; is the port in use by another process?"
            ) from None
        self._clock = machine_clock()
        self._declared: list[object] = []

    def publisher(self, key: str, *, wait_when_full: bool = False) -> ZenohPublisher:
        """A publisher that drops a message it cannot send at once, or one that waits."""
        publisher = ZenohPublisher(
            self._session, key, clock=self._clock, wait_when_full=wait_when_full
        )
        self._declared.append(publisher)
        return publisher

    def subscribe(self, key: str, receive: Callable[[Delivery], None]) -> None:
        def callback(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            envelope = Envelope.decode(attachment.to_bytes() if attachment is not None else None)
            receive(Delivery(sample.payload.to_bytes(), envelope))

        # On Zenoh's own thread: one hop less, and `receive` returns at once.
        direct = zenoh.handlers.Callback(callback, indirect=False)
        self._declared.append(self._session.declare_subscriber(key, direct))

    def close(self) -> None:
        self._declared.clear()
        self._session.close()


class ZenohPublisher:
    """Publisher of a `ZenohBus`."""

    def __init__(
        self, session: zenoh.Session, key: str, *, clock: int, wait_when_full: bool
    ) -> None:
        congestion = zenoh.CongestionControl
        self._publisher = session.declare_publisher(
            key,
            congestion_control=congestion.BLOCK if wait_when_full else congestion.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._clock = clock
        self._session = new_session()
        self.sent = 0

    def publish(self, data: bytes) -> None:
        envelope = Envelope(self._session, self.sent, time.monotonic_ns(), self._clock)
        self.forward(Delivery(data, envelope))

    def forward(self, delivery: Delivery) -> None:
        envelope = delivery.envelope
        self._publisher.put(
            delivery.data, attachment=None if envelope is None else envelope.encode()
        )
        self.sent += 1


def _cause(error: Exception) -> str:
    """The first clause of Zenoh's error, without source locations."""
    text = re.sub(r"\s+at \S+\.rs:\d+\.?", "", str(error))
    return text.strip().rstrip(".").splitlines()[0][:200]
