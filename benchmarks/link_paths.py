"""The paths between the two ends of a link under test, as contexts.

`direct` has nothing in between, `shim` the real `./wbc netem replay`, and `packets` the
packet-level shim. `kernel` has the kernel's emulation, `tc … netem`, where the machine has it.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from deploy.process_stat import processor_seconds
from netem.tun import DEVICE, EDGE_ADDRESS, ROBOT_ADDRESS, why_not_permitted
from shared.errors import LinkError
from shared.process.entry import end_with_parent, python

READY_SECONDS = 60.0
_END_SECONDS = 30.0
_NAMESPACES = ("wbc-bench-robot", "wbc-bench-edge")
_PORT = 7460
# Below the ports that Linux gives to a socket that asks for any.
_CHOSEN_PORTS = range(20_000, 32_000)
# 10 s of 40 kB messages in packets of 1500 bytes: the kernel's default of 1000 would drop most.
_KERNEL_PACKETS = 300_000


class Started:
    """A separate process of one of the project's modules."""

    def __init__(self, *arguments: str, prefix: tuple[str, ...] = ()) -> None:
        self._name = " ".join(arguments[:2])
        self._popen = subprocess.Popen(
            [*prefix, *python("-m", *arguments)],
            stdout=subprocess.PIPE,
            preexec_fn=end_with_parent(),
        )
        self._heard = b""

    def wait_for(self, word: str, *, seconds: float = READY_SECONDS) -> None:
        """Wait until the process has printed `word`. Raise `LinkError` if it ends before."""
        assert self._popen.stdout is not None
        deadline = time.monotonic() + seconds
        while word.encode() not in self._heard:
            left = max(0.0, deadline - time.monotonic())
            readable, _, _ = select.select([self._popen.stdout], (), (), left)
            if not readable:
                raise LinkError(f"{self._name} did not say {word} within {seconds:g} s")
            chunk = os.read(self._popen.stdout.fileno(), 65_536)
            if not chunk:
                raise LinkError(f"{self._name} ended without saying {word}")
            self._heard += chunk

    @property
    def output(self) -> str:
        """Return the output so far."""
        return self._heard.decode(errors="replace")

    def processor_seconds(self) -> float:
        """Return the user and system time so far [s]."""
        return processor_seconds(self._popen.pid)

    def end(self) -> None:
        """Ask the process to stop."""
        if self._popen.poll() is None:
            self._popen.send_signal(signal.SIGTERM)

    def wait(self) -> None:
        """Wait until the process has stopped. Kill it after a timeout."""
        try:
            self._popen.wait(timeout=_END_SECONDS)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()
        assert self._popen.stdout is not None
        self._popen.stdout.close()


@dataclass(frozen=True)
class LinkPath:
    """Endpoints that the far end listens on and the near end dials, the commands that both ends'
    commands follow, and the process in between.
    """

    listen: str
    dial: str
    near_prefix: tuple[str, ...] = ()
    far_prefix: tuple[str, ...] = ()
    between: Started | None = None


@contextmanager
def started(*arguments: str, prefix: tuple[str, ...] = (), wait: bool = True) -> Iterator[Started]:
    """Start a process, wait until it is ready if `wait`, and end it with the context."""
    process = Started(*arguments, prefix=prefix)
    try:
        if wait:
            process.wait_for("READY")
        yield process
    finally:
        process.end()
        process.wait()


@contextmanager
def direct() -> Iterator[LinkPath]:
    """Loopback, nothing in between."""
    (endpoint,) = free_endpoints(1)
    yield LinkPath(listen=endpoint, dial=endpoint)


@contextmanager
def shim(network: str, *, out: Path) -> Iterator[LinkPath]:
    """The shim between two loopback connections, ready once the far end listens; logs in `out`."""
    far, near = free_endpoints(2)
    where = ("--listen", near, "--connect", far, "--out", str(out))
    with started("netem", "replay", network, *where, wait=False) as process:
        yield LinkPath(listen=far, dial=near, between=process)


@contextmanager
def packets(network: str, *, mtu: int, protocol: str) -> Iterator[LinkPath]:
    """One connection, from one network namespace to another through the packet-level shim."""
    robot, edge = _NAMESPACES
    names = ("--robot-ns", robot, "--edge-ns", edge, "--mtu", str(mtu))
    with started("netem", "packets", network, *names) as process:
        yield _between_namespaces(protocol, process)


@contextmanager
def kernel(delays_ms: tuple[float, float]) -> Iterator[LinkPath]:
    """One connection over a veth pair whose ends delay by `tc … netem`, up and down [ms]."""
    addresses = (ROBOT_ADDRESS, EDGE_ADDRESS)
    with ExitStack() as stack:
        for name in _NAMESPACES:
            _command("ip", "netns", "add", name)
            stack.callback(subprocess.run, ["ip", "netns", "del", name], check=False)
        robot, edge = _NAMESPACES
        ends = (DEVICE, "netns", robot, "type", "veth", "peer", "name", DEVICE, "netns", edge)
        _command("ip", "link", "add", *ends)
        for name, address, delay_ms in zip(_NAMESPACES, addresses, delays_ms, strict=True):
            _command("ip", "-n", name, "addr", "add", f"{address}/30", "dev", DEVICE)
            _command("ip", "-n", name, "link", "set", "dev", DEVICE, "up")
            emulation = ("netem", "delay", f"{delay_ms}ms", "limit", str(_KERNEL_PACKETS))
            _command("tc", "-n", name, "qdisc", "add", "dev", DEVICE, "root", *emulation)
        yield _between_namespaces("tcp", None)


def why_no_kernel() -> str | None:
    """Return the reason why the kernel cannot delay here, or None if it can."""
    missing = why_not_permitted()
    if missing is not None:
        return missing
    try:
        with kernel((1.0, 1.0)):
            return None
    except LinkError as error:
        return str(error)


def free_endpoints(count: int) -> list[str]:
    """Return loopback endpoints that no process uses.

    Before a process listens there, Linux gives their ports to no socket that asks for any.
    """
    ports: set[int] = set()
    while len(ports) < count:
        port = random.choice(_CHOSEN_PORTS)
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            ports.add(port)
    return [f"tcp/127.0.0.1:{port}" for port in ports]


def _between_namespaces(protocol: str, between: Started | None) -> LinkPath:
    robot, edge = _NAMESPACES
    endpoint = f"{protocol}/{EDGE_ADDRESS}:{_PORT}"
    inside = ("ip", "netns", "exec")
    return LinkPath(
        listen=endpoint,
        dial=endpoint,
        near_prefix=(*inside, robot),
        far_prefix=(*inside, edge),
        between=between,
    )


def _command(*words: str) -> None:
    try:
        done = subprocess.run(words, check=False, capture_output=True, text=True)
    except FileNotFoundError:
        raise LinkError(f"expected the command {words[0]}, got none; install iproute2") from None
    if done.returncode != 0:
        reason = (done.stderr.strip() or "no reason given").splitlines()[-1]
        raise LinkError(f"{' '.join(words)}: {reason}")
