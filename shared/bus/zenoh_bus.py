"""The bus over a network: Zenoh, configured for newest-wins control traffic.

Endpoints are explicit (no multicast, no gossip), so that two processes talk only through the
processes between them. Shared memory is off: it would bypass the link. Publishers send at real-time
priority, without batching, and drop a message rather than wait. Only the shim waits, because it
releases hundreds of messages at the end of an outage. With credentials, every connection is mutual
TLS and every key is granted by name: `shared/bus/security.py`.
"""

from __future__ import annotations

import contextlib
import json
import re
import resource
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import zenoh

from shared.bus.base import CLOSING, Delivery, Envelope, new_session
from shared.bus.endpoint import parse_endpoint
from shared.bus.preflight import preflight
from shared.bus.security import Credentials
from shared.bus.silence_limit import SilenceLimit
from shared.errors import LinkError

# A slow link should lose messages, not store them: a message that waits here is old when it
# arrives. So few batches wait in the process (Zenoh's default of two loses bursts of 40 kB
# messages), and the kernel's send buffer is small (the kernel doubles the size asked for). If the
# send buffer held less than the bytes under way on the path, messages would wait for
# acknowledgements. These sizes are for 1 MB/s of states at a round trip of 30 ms, and 100 Mbit/s of
# projectors at 10 ms. Measured: docs/real-network.md.
_LINK_BATCHES, _LOCAL_BATCHES = 4, 16
_SMALL_MESSAGE = 1_000
_SMALL_SEND_BUFFER, _SEND_BUFFER, _LOCAL_SEND_BUFFER = 32_768, 131_072, 262_144
# Bytes of a datagram: with its headers, one packet of 1500. Larger ones travel as IP fragments, and
# while some packets are lost the kernel keeps the rest for 30 s, until it takes no more.
_DATAGRAM = 1400
# A robot that has lost its edge cannot wait for Zenoh's four seconds between two attempts.
_RETRY = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 2}
# A stack of five services needs about half of these.
_LIMITS = (
    (resource.RLIMIT_NOFILE, 100, 1, "open files", "ulimit -n 1024"),
    (resource.RLIMIT_AS, 2 << 30, 1 << 30, "GiB of address space", "ulimit -v unlimited"),
)
# A healthy session closes within 0.1 s.
_CLOSE_SECONDS = 1.0
# Zenoh's own, for local sessions and measurements.
_LEASE_SECONDS = 10.0
# Long enough for a TLS handshake over a link that stalls. Between attempts, a stop signal is seen.
_ATTEMPT_SECONDS = 3.0
# Requests on a key that may wait for their answers.
_MAX_REQUESTS = 4


def machine_clock() -> int:
    """Return a number for this machine's monotonic clock, the same in every process of a boot."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except OSError:
        return 0
    return zlib.crc32(boot.encode())


class ZenohBus:
    """One Zenoh session. Raises `LinkError` if an endpoint cannot be used.

    A `peer` speaks to the nodes to which it is connected, a `client` to all nodes behind the one
    that it has dialled. A `router` carries messages between its clients. `largest` is the maximum
    size of a message over a link [bytes], and makes buffers small; None: the session is local.
    After `lease` [s] without a sign of life of the other end, a `tcp/` connection counts as lost
    and is made again. TCP alone may stay silent after an outage for as long as the outage lasted.
    Zenoh cannot close a TLS connection with a full queue, so the kernel ends a `tls/` connection
    after that time (Linux). Connections of other protocols keep Zenoh's lease. `settings` are
    further settings of Zenoh.
    """

    _silence: SilenceLimit | None = None

    def __init__(
        self,
        *,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        mode: str = "peer",
        largest: int | None = None,
        lease: float = _LEASE_SECONDS,
        credentials: Credentials | None = None,
        settings: dict[str, Any] | None = None,
    ) -> None:
        endpoints = [
            parse_endpoint(endpoint, secured=credentials is not None)
            for endpoint in (*listen, *connect)
        ]
        protocols = {each.protocol for each in endpoints}
        _check_limits()
        batches, send_buffer = _buffers(largest)
        config = zenoh.Config()
        for key, value in {
            "mode": mode,
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "connect/retry": _RETRY,
            "listen/timeout_ms": 0,
            "listen/exit_on_failure": True,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/link/tx/queue/size/real_time": batches,
            "transport/link/tcp/so_sndbuf": send_buffer,
            "transport/link/tls/so_sndbuf": send_buffer,
            **({"transport/link/tx/lease": round(1e3 * lease)} if protocols == {"tcp"} else {}),
            **({"transport/link/tx/batch_size": _DATAGRAM} if "udp" in protocols else {}),
            **({} if credentials is None else credentials.settings()),
            **(settings or {}),
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
        ports = [each.port for each in endpoints if each.protocol == "tls"]
        if ports:
            self._silence = SilenceLimit(ports, seconds=lease)

    @classmethod
    def dial(
        cls,
        endpoint: str,
        *,
        within: float,
        largest: int | None = None,
        lease: float = _LEASE_SECONDS,
        credentials: Credentials | None = None,
        stopping: Callable[[], bool] = lambda: False,
    ) -> ZenohBus:
        """Return a client of the node at `endpoint`: an edge, a shim or a router.

        Try for `within` [s], then raise `LinkError` with the finding of `preflight`. Raise it at
        once if an end refuses the other's certificate. Raise `KeyboardInterrupt` when `stopping()`
        is true. A connection that is lost later is made again automatically.
        """
        deadline = time.monotonic() + within
        while True:
            found = preflight(endpoint, credentials)
            left = deadline - time.monotonic()
            if stopping():
                raise KeyboardInterrupt
            try:
                return cls(
                    connect=[endpoint],
                    mode="client",
                    largest=largest,
                    lease=lease,
                    credentials=credentials,
                    settings={
                        "connect/timeout_ms": round(1e3 * min(max(left, 0.1), _ATTEMPT_SECONDS)),
                        "connect/exit_on_failure": True,
                    },
                )
            except LinkError:
                if time.monotonic() > deadline:
                    raise LinkError(f"no connection within {within:g} s: {found}") from None

    def publisher(self, key: str, *, wait_when_full: bool = False) -> ZenohPublisher:
        """Return a publisher that drops a message it cannot send at once, or one that waits."""
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

        # Called on Zenoh's thread, which saves a hop: `receive` returns at once.
        direct = zenoh.handlers.Callback(callback, indirect=False)
        self._declared.append(self._session.declare_subscriber(key, direct))

    def serve(self, key: str) -> ZenohRequests:
        """Return the requests that other sessions make on a key.

        At most `_MAX_REQUESTS` wait. A flood of them is dropped outside of Python, so that it takes
        no time from this process's threads.
        """
        waiting: zenoh.handlers.RingChannel[zenoh.Query] = zenoh.handlers.RingChannel(_MAX_REQUESTS)
        queryable = self._session.declare_queryable(key, waiting)
        self._declared.append(queryable)
        return ZenohRequests(queryable)

    def ask(self, key: str, data: bytes, *, within: float) -> bytes | None:
        """Make a request and return its answer; None if no process has answered `within` [s]."""
        for reply in self._session.get(key, payload=data, timeout=within):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    def close(self) -> None:
        """Close the session. Never raise, and return after at most a second.

        If the neighbour is frozen or its cable is cut, Zenoh waits for more than ten seconds, and
        then raises. The close goes on in a thread then, and `shared.process.cli.run` ends the
        process without waiting for it.
        """
        if self._silence is not None:
            self._silence.close()
        closing = threading.Thread(target=self._close, name=CLOSING, daemon=True)
        try:
            closing.start()
        except RuntimeError:
            # No memory for a thread: the end of the process closes the session.
            return
        closing.join(_CLOSE_SECONDS)

    def _close(self) -> None:
        with contextlib.suppress(zenoh.ZError):
            # The last reference to a publisher or a subscriber undeclares it, which may wait too.
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
        self.session = new_session()
        self.sent = 0

    def publish(self, data: bytes) -> None:
        envelope = Envelope(self.session, self.sent, time.monotonic_ns(), self._clock)
        self.forward(Delivery(data, envelope))

    def forward(self, delivery: Delivery) -> None:
        envelope = delivery.envelope
        self._publisher.put(
            delivery.data, attachment=None if envelope is None else envelope.encode()
        )
        self.sent += 1


class ZenohRequests:
    """Requests on one key of a `ZenohBus`."""

    def __init__(self, queryable: zenoh.Queryable[Any]) -> None:
        self._queryable = queryable

    def answer(self, respond: Callable[[bytes], bytes]) -> bool:
        """Wait for a request and answer it. Return False once the bus is closed."""
        try:
            query = self._queryable.recv()
        except zenoh.ZError:
            return False
        with query:
            payload = query.payload
            query.reply(query.key_expr, respond(b"" if payload is None else payload.to_bytes()))
        return True


def _check_limits() -> None:
    """Raise `LinkError` if a limit of this process is too low: a session would then hang."""
    for limit, least, unit, name, remedy in _LIMITS:
        allowed, _ = resource.getrlimit(limit)
        if allowed != resource.RLIM_INFINITY and allowed < least:
            raise LinkError(
                f"expected a limit of at least {least / unit:g} {name}, got {allowed / unit:g}; "
                f"raise it: {remedy}"
            )


def _buffers(largest: int | None) -> tuple[int, int]:
    """Return how many batches may wait in the process, and the kernel's send buffer [bytes]."""
    if largest is None:
        return _LOCAL_BATCHES, _LOCAL_SEND_BUFFER
    return _LINK_BATCHES, _SMALL_SEND_BUFFER if largest <= _SMALL_MESSAGE else _SEND_BUFFER


def _cause(error: Exception) -> str:
    """Return the first line of Zenoh's error, without source locations."""
    text = re.sub(r"\s+at \S+\.rs:\d+\.?", "", str(error))
    return text.strip().rstrip(".").splitlines()[0][:200]
