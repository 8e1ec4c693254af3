"""Endpoints in Zenoh's form: `PROTOCOL/HOST:PORT`, and Zenoh's settings after a #."""

from __future__ import annotations

import re
from dataclasses import dataclass

from shared.errors import LinkError

SECURE_PROTOCOLS = ("tls", "quic")
_PROTOCOLS = (*SECURE_PROTOCOLS, "tcp", "udp", "ws", "unixsock-stream")
_SHAPE = re.compile(rf"({'|'.join(_PROTOCOLS)})/(\[[^\]]+\]|[^:\[\]#?]+):(\d+)([#?]\S*)?")
_SOCKET_FILE = re.compile(r"(unixsock-stream)/(\S+)")
_LOOPBACK = re.compile(r"127\.\d+\.\d+\.\d+|localhost|::1")


@dataclass(frozen=True)
class Endpoint:
    """The parts of an endpoint; `host` without brackets. A socket file has port 0."""

    protocol: str
    host: str
    port: int
    settings: str = ""

    @property
    def secured(self) -> bool:
        """Return whether the protocol has certificates."""
        return self.protocol in SECURE_PROTOCOLS

    @property
    def on_loopback(self) -> bool:
        """Return whether the endpoint is on this machine only."""
        return self.port == 0 or _LOOPBACK.fullmatch(self.host) is not None

    @property
    def dialled_here(self) -> Endpoint:
        """The endpoint by which a process of this machine reaches the listener at this endpoint."""
        if self.host not in ("0.0.0.0", "::"):
            return self
        return Endpoint(self.protocol, "127.0.0.1", self.port, self.settings)

    def __str__(self) -> str:
        if self.port == 0:
            return f"{self.protocol}/{self.host}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}{self.settings}"


def parse_endpoint(text: str, *, secured: bool) -> Endpoint:
    """Return the parts of an endpoint.

    Raise `LinkError` if the text is no endpoint, or if its protocol does not fit `secured`.
    """
    match = _SHAPE.fullmatch(text)
    file = _SOCKET_FILE.fullmatch(text)
    if match is not None and int(match[3]) in range(1, 65536):
        endpoint = Endpoint(match[1], match[2].strip("[]"), int(match[3]), match[4] or "")
    elif file is not None:
        endpoint = Endpoint(file[1], file[2], 0)
    else:
        raise LinkError(
            f"endpoint: expected PROTOCOL/HOST:PORT as in tcp/127.0.0.1:7460, with one of "
            f"{', '.join(_PROTOCOLS)}, got {text!r}"
        )
    if secured and not endpoint.secured:
        raise LinkError(
            f"endpoint: expected {' or '.join(SECURE_PROTOCOLS)} with --secure, got {text!r}"
        )
    if endpoint.secured and not secured:
        raise LinkError(f"endpoint: {text} needs certificates; add --secure DIR")
    return endpoint
