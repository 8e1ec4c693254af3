"""Two machines on one, joined by a long cable: a rate, a delay, and a modem's buffer at each end.

The cable is `./wbc netem packets` over a link of constant capacity: not every kernel can delay
packets itself. It takes its share of the processor. Linux only, as root.
"""

from __future__ import annotations

import contextlib
import re
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.real_path.namespaces import QUEUE_MS, Machines, name_machines
from shared.errors import ConfigError, LinkError
from shared.process.entry import python

_RATE = re.compile(r"(\d+)([kmg])bit")
_BITS = {"k": 1e3, "m": 1e6, "g": 1e9}
_STOP_SECONDS = 10.0
# `capacity:` takes what a message's own bytes would have needed off the delay: a tenth of a period.
_OWN_MS = 0.1


@contextlib.contextmanager
def machines_on_long_cable(*, rate: str, round_trip_ms: float) -> Iterator[Machines]:
    """Two machines joined at `rate`, in the notation of `tc` (100mbit); removed afterwards.

    `LinkError` gives the reason if they cannot be made.
    """
    machines = name_machines()
    names = ("--robot-ns", machines.robot.namespace, "--edge-ns", machines.edge.namespace)
    with tempfile.TemporaryDirectory() as folder:
        options = cable_options(
            Path(folder), carried=bytes_per_ms(rate), one_way_ms=round_trip_ms / 2
        )
        cable = subprocess.Popen(
            python("-m", "netem", "packets", *options, *names),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            assert cable.stdout is not None
            first = cable.stdout.readline().strip()
            if not first.startswith("READY"):
                raise LinkError(first.removeprefix("error: ") or "the cable did not start")
            yield machines
        finally:
            cable.terminate()
            cable.communicate(timeout=_STOP_SECONDS)


def bytes_per_ms(rate: str) -> float:
    """Convert a rate in the notation of `tc` to bytes per ms."""
    match = _RATE.fullmatch(rate)
    if match is None or int(match[1]) == 0:
        raise ConfigError(f"rate: expected 100mbit, with kbit, mbit or gbit, got {rate!r}")
    return int(match[1]) * _BITS[match[2]] / 8.0 / 1000.0


def cable_options(folder: Path, *, carried: float, one_way_ms: float) -> tuple[str, ...]:
    """Write the files of a link that carries `carried` bytes per ms each way. Return the options
    that name them.
    """
    profile, config = folder / "cable.csv", folder / "cable.toml"
    delay_ms = one_way_ms + _OWN_MS
    profile.write_text(
        "uplink_ms,downlink_ms,uplink_capacity_bytes,downlink_capacity_bytes\n"
        f"{delay_ms},{delay_ms},{carried},{carried}\n",
        encoding="utf-8",
    )
    # The bytes on the cable itself count as well.
    held_ms = one_way_ms + QUEUE_MS
    config.write_text(f"[link]\nqueue_bytes = {round(carried * held_ms)}\n", encoding="utf-8")
    return f"capacity:{profile}", "--config", str(config)
