"""Two network namespaces with a TUN device in each: the ends of a link through this process.

A packet that a process in one namespace sends to the other's address can be read here at a file
descriptor, one IP packet per read. A packet written to the other descriptor arrives in the other
namespace. Needs root and /dev/net/tun. The devices vanish when the process that made them ends.
After a killed run the names of the namespaces remain.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import shutil
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from shared.errors import LinkError

ROBOT_ADDRESS, EDGE_ADDRESS = "10.77.0.1", "10.77.0.2"
DEVICE = "link0"
_PREFIX = 30
_TUN = Path("/dev/net/tun")
_MODULE = f"try `modprobe tun`, or in a container --device {_TUN}"
# linux/if_tun.h: a layer-3 device, packets without a header of the driver.
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_IFREQ = struct.Struct("16sH22x")
# Packets that a device holds until they are read. The default of 500 is 18 messages of 40 kB.
_DEVICE_PACKETS = 10_000
MIN_MTU, MAX_MTU = 576, 65_535


@dataclass(frozen=True)
class End:
    """One end of the link: processes run in `namespace`, packets pass through `descriptor`."""

    namespace: str
    address: str
    descriptor: int


def why_not_permitted() -> str | None:
    """The first missing precondition for a pair of namespaces, as an error text; None if met."""
    if sys.platform != "linux":
        return f"network namespaces and TUN devices need Linux, got {sys.platform}"
    if os.geteuid() != 0:
        return "network namespaces and TUN devices need root; try sudo"
    if shutil.which("ip") is None:
        return "expected the command ip, got none; install iproute2"
    if not _TUN.exists():
        return f"expected {_TUN}, got none; {_MODULE}"
    return None


class NamespacePair:
    """A context that makes and removes namespaces and devices. `LinkError` if it cannot."""

    def __init__(self, *, robot: str, edge: str, mtu: int) -> None:
        self._names = (robot, edge)
        self._mtu = mtu
        self._made: list[str] = []
        self._descriptors: list[int] = []

    def __enter__(self) -> tuple[End, End]:
        """Make the robot's end and the edge's end."""
        missing = why_not_permitted()
        if missing is not None:
            raise LinkError(missing)
        self._refuse_leftovers()
        try:
            robot, edge = (
                self._end(name, address)
                for name, address in zip(self._names, (ROBOT_ADDRESS, EDGE_ADDRESS), strict=True)
            )
        except BaseException:
            self._remove()
            raise
        return robot, edge

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._remove()

    def dropped(self) -> list[int]:
        """The number of packets that each end's device dropped before they were read."""
        return [_transmit_drops(name) for name in self._made]

    def _refuse_leftovers(self) -> None:
        present = [name for name in self._names if name in namespaces()]
        if not present:
            return
        inside = [pid for name in present for pid in _ip("netns", "pids", name).split()]
        where = " and ".join(present)
        if inside:
            raise LinkError(
                f"namespace {where} is in use by process {', '.join(inside)}; end it, or choose "
                "other names with --robot-ns and --edge-ns"
            )
        remedy = " && ".join(f"ip netns del {name}" for name in present)
        raise LinkError(f"namespace {where} is left from a killed run; remove it with {remedy}")

    def _end(self, name: str, address: str) -> End:
        _ip("netns", "add", name)
        self._made.append(name)
        descriptor, device = _open_tun()
        self._descriptors.append(descriptor)
        _ip("link", "set", "dev", device, "netns", name, "name", DEVICE)
        # No IPv6: its messages would be packets on the link that no program sent.
        _ip("-n", name, "link", "set", "dev", DEVICE, "addrgenmode", "none")
        _ip("-n", name, "addr", "add", f"{address}/{_PREFIX}", "dev", DEVICE)
        _ip("-n", name, "link", "set", "dev", DEVICE, "mtu", str(self._mtu))
        _ip("-n", name, "link", "set", "dev", DEVICE, "txqueuelen", str(_DEVICE_PACKETS))
        _ip("-n", name, "link", "set", "dev", DEVICE, "up")
        _ip("-n", name, "link", "set", "dev", "lo", "up")
        return End(name, address, descriptor)

    def _remove(self) -> None:
        for descriptor in self._descriptors:
            os.close(descriptor)
        for name in self._made:
            # The namespace may have been removed already.
            with contextlib.suppress(LinkError):
                _ip("netns", "del", name)
        self._descriptors, self._made = [], []


def namespaces() -> list[str]:
    """Names of the network namespaces of this machine."""
    return [line.split()[0] for line in _ip("netns", "list").splitlines() if line.strip()]


def _open_tun() -> tuple[int, str]:
    """Make a device in this process's namespace. Return its non-blocking descriptor and name."""
    descriptor = -1
    try:
        descriptor = os.open(_TUN, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        request = _IFREQ.pack(b"wbc%d", _IFF_TUN | _IFF_NO_PI)
        answer = fcntl.ioctl(descriptor, _TUNSETIFF, request)
    except OSError as error:
        if descriptor >= 0:
            os.close(descriptor)
        remedy = _MODULE if error.errno in (errno.ENODEV, errno.ENXIO) else "needs CAP_NET_ADMIN"
        raise LinkError(f"cannot make a TUN device: {error.strerror}; {remedy}") from None
    return descriptor, answer[:16].rstrip(b"\0").decode()


def _transmit_drops(namespace: str) -> int:
    try:
        links: Any = json.loads(_ip("-n", namespace, "-j", "-s", "link", "show", "dev", DEVICE))
        return int(links[0]["stats64"]["tx"]["dropped"])
    except (LinkError, ValueError, LookupError):
        return 0


def _ip(*arguments: str) -> str:
    """Run `ip …`. Return its output; `LinkError` with its error text if it fails."""
    # A new session: Ctrl-C at the terminal must not end the command halfway.
    done = subprocess.run(
        ["ip", *arguments], check=False, capture_output=True, text=True, start_new_session=True
    )
    if done.returncode != 0:
        reason = (done.stderr.strip() or "no reason given").splitlines()[-1]
        denied = "permitted" in reason or "denied" in reason
        remedy = "; in a container it needs CAP_SYS_ADMIN and CAP_NET_ADMIN" if denied else ""
        raise LinkError(f"ip {' '.join(arguments)}: {reason}{remedy}")
    return done.stdout
