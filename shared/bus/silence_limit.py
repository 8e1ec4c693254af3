"""A limit on the silence of TLS connections: Linux's TCP_USER_TIMEOUT.

TCP waits twice as long after each attempt to repeat a packet. So an outage lasts up to twice as
long for a connection as for the cable. With the option the kernel ends a connection whose data the
other end has not acknowledged for a time, and Zenoh makes a new one. Zenoh opens its sockets
without the option, also after an outage, so they are searched for in this process's open files.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Iterable
from pathlib import Path

_FILES = Path("/proc/self/fd")
# Between two searches [s]. A new connection is not silent at once.
_PERIOD = 0.5
_FAMILIES = (socket.AF_INET, socket.AF_INET6)


def limit_silence(ports: Iterable[int], *, seconds: float) -> int:
    """Limit the silence of this process's TCP connections and listeners at some ports.

    Return the number of these sockets; 0 on a system without the option.
    """
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is None or not _FILES.is_dir():
        return 0
    wanted, found = set(ports), 0
    for file in _FILES.iterdir():
        # A file may be closed at any time.
        with contextlib.suppress(OSError):
            if not os.readlink(file).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(file.name))) as each:
                is_tcp = each.family in _FAMILIES and each.type == socket.SOCK_STREAM
                if is_tcp and wanted & _ports_of(each):
                    each.setsockopt(socket.IPPROTO_TCP, option, round(1e3 * seconds))
                    found += 1
    return found


def _ports_of(each: socket.socket) -> set[int]:
    """Return the ports of both ends. A listener has one end."""
    ports = {each.getsockname()[1]}
    with contextlib.suppress(OSError):
        ports.add(each.getpeername()[1])
    return ports


class SilenceLimit:
    """Keeps the limit on all connections at some ports, also on later ones, until it is closed."""

    def __init__(self, ports: Iterable[int], *, seconds: float) -> None:
        self._ports, self._seconds = tuple(ports), seconds
        self._closed = threading.Event()
        # Without memory for a thread the outages of this session are longer.
        with contextlib.suppress(RuntimeError):
            threading.Thread(target=self._keep, daemon=True).start()

    def close(self) -> None:
        """Leave later connections alone."""
        self._closed.set()

    def _keep(self) -> None:
        while True:
            limit_silence(self._ports, seconds=self._seconds)
            if self._closed.wait(_PERIOD):
                return
