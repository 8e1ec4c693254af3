"""Two machines on one: network namespaces joined by a cable of limited rate.

Each has its own loopback, addresses and routes, and nothing but the cable leads from one to the
other. Linux only, as root, with `ip` and `tc` of iproute2.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from shared.errors import UserError

_SECONDS = 10.0
_PREFIX = "wbc-"
_DEVICE = "cable"
# The buffer of the cable beyond its rate before it drops, like a modem's.
QUEUE_MS = 50


@dataclass(frozen=True)
class Machine:
    """A namespace and its address on the cable. `drop` needs `iptables`."""

    namespace: str
    address: str

    def command(self, *arguments: str) -> list[str]:
        """Return a command line that runs `arguments` in the namespace."""
        return ["ip", "netns", "exec", self.namespace, *arguments]

    def drop(self, probability: float) -> None:
        """Drop each packet that arrives over the cable with a probability, from now on; 0: none."""
        rules = ("iptables", "-t", "mangle")
        _run(*self.command(*rules, "-F", "PREROUTING"))
        if probability > 0.0:
            randomly = ("-m", "statistic", "--mode", "random", "--probability", str(probability))
            _run(*self.command(*rules, "-A", "PREROUTING", "-i", _DEVICE, *randomly, "-j", "DROP"))


@dataclass(frozen=True)
class Machines:
    """The two ends of the cable."""

    robot: Machine
    edge: Machine

    def cut(self) -> None:
        """Cut the cable: messages get lost, and neither end is told."""
        for machine, other in ((self.robot, self.edge), (self.edge, self.robot)):
            nobody = ("lladdr", "02:00:00:00:00:01", "dev", _DEVICE, "nud", "permanent")
            _run("ip", "-n", machine.namespace, "neigh", "replace", other.address, *nobody)

    def mend(self) -> None:
        """Join the cable again after a cut."""
        for machine, other in ((self.robot, self.edge), (self.edge, self.robot)):
            _run("ip", "-n", machine.namespace, "neigh", "del", other.address, "dev", _DEVICE)


@contextlib.contextmanager
def two_machines(*, rate: str) -> Iterator[Machines]:
    """Two machines joined at `rate`, in the notation of `tc` (100mbit); removed afterwards.

    `UserError` gives the reason if they cannot be made. Their names hold the pid, so that several
    pairs may run at a time. A later call removes the machines of a killed process.
    """
    for tool in ("ip", "tc"):
        if shutil.which(tool) is None:
            raise UserError(f"namespaces: expected {tool} of iproute2 on this machine, found none")
    if os.geteuid() != 0:
        raise UserError("namespaces: only root may make them; run as root")
    machines = name_machines()
    made: list[Machine] = []
    try:
        for machine in (machines.robot, machines.edge):
            _run("ip", "netns", "add", machine.namespace)
            made.append(machine)
        ends = (machines.robot.namespace, "type", "veth", "peer", "name", _DEVICE)
        _run(*("ip", "link", "add", _DEVICE, "netns", *ends, "netns", machines.edge.namespace))
        for machine in made:
            _connect(machine, rate=rate)
        yield machines
    finally:
        for machine in made:
            _run("ip", "netns", "delete", machine.namespace, check=False)


def name_machines() -> Machines:
    """Name two machines of this process, not yet made. Remove the machines of killed processes."""
    _remove_leftovers()
    return Machines(
        robot=Machine(f"{_PREFIX}robot-{os.getpid()}", "10.77.0.1"),
        edge=Machine(f"{_PREFIX}edge-{os.getpid()}", "10.77.0.2"),
    )


def _remove_leftovers() -> None:
    for path in Path("/run/netns").glob(f"{_PREFIX}*-*"):
        pid = path.name.rpartition("-")[2]
        if pid.isdigit() and not Path("/proc", pid).exists():
            _run("ip", "netns", "delete", path.name, check=False)


def _connect(machine: Machine, *, rate: str) -> None:
    inside = ("ip", "-n", machine.namespace)
    _run(*inside, "address", "add", f"{machine.address}/24", "dev", _DEVICE)
    for device in ("lo", _DEVICE):
        _run(*inside, "link", "set", device, "up")
    # One packet a frame, as on a real cable: a drop is that of a packet, not of a whole message.
    _run(*inside, "link", "set", _DEVICE, "gso_max_segs", "1")
    limit = ("tbf", "rate", rate, "burst", "64kb", "latency", f"{QUEUE_MS}ms")
    _run("tc", "-n", machine.namespace, "qdisc", "add", "dev", _DEVICE, "root", *limit)


def _run(*command: str, check: bool = True) -> None:
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=_SECONDS,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    if check and done.returncode != 0:
        reason = (done.stderr.strip() or f"exit {done.returncode}").splitlines()[0]
        raise UserError(f"namespaces: {' '.join(command)} failed: {reason}")
