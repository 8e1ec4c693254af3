"""Accuracy of the emulated link: nominal against achieved delay of every message.

Two ends (`link_end`) send 1 kB up and 40 kB down at 1 kHz each way. A message's error is its
achieved minus its nominal delay. *Released* counts from the sender's stamp until the shim has
handed the message on. *Received* counts until the receiver's callback, with the transport behind
the shim in it. The round trip is that of 1 kB out and of the 40 kB answer to it.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.link_paths import (
    LinkPath,
    direct,
    kernel,
    packets,
    shim,
    why_no_kernel,
)
from benchmarks.link_trial import LinkTrial, Open, run_trial, way_errors
from benchmarks.timing import cores_busy, header_of_processes
from netem.profile import DIRECTIONS
from netem.tun import why_not_permitted
from shared.process.entry import end_with_parent, python

_LOADS = ("idle", "loaded")
# Half of a constant:20ms.
_ONE_WAY_MS = 10.0
_ONE_WAY_NS = 10_000_000
_QUANTILES = "    p50     p99     max"


@dataclass(frozen=True)
class _Case:
    """A path, and the one-way delay [ns] if no shim logs the nominal delay."""

    name: str
    open_path: Open
    one_way_ns: int | None = None


_DIRECT = _Case("direct", lambda out: direct(), 0)
_PASS = _Case("shim constant:0ms", lambda out: shim("constant:0ms", out=out))
_SHIM = (
    _PASS,
    _Case("shim constant:20ms", lambda out: shim("constant:20ms", out=out)),
    _Case("shim factory/011", lambda out: shim("factory/011", out=out)),
)
_KERNEL = _Case("kernel netem 10 ms", lambda out: kernel((_ONE_WAY_MS, _ONE_WAY_MS)), _ONE_WAY_NS)


def run(*, seconds: float) -> str:
    """Measure every path, idle and with every core busy. Return the tables as text."""
    busy = cores_busy(seconds=2.0)
    references, remarks = _references()
    errors, trips, scheduling = [], [], ""
    for case in (_DIRECT, *_SHIM, *references):
        for load in _LOADS:
            trial = _try(case, load, seconds=seconds)
            scheduling = trial.scheduling
            errors += _error_lines(case, load, trial)
    for case in (_DIRECT, _PASS):
        for load in _LOADS:
            round_trips_ns = _try(case, load, seconds=seconds, answer=True).round_trips_ns()
            trips.append(f"{case.name:30}{load:18}{_quantiles(round_trips_ns)}")
    return "\n".join(
        [
            header_of_processes(busy, scheduling),
            f"{seconds:g} s each; loaded: a busy process of ordinary priority for every core",
            "",
            f"{'delay error [ms]':77}released{'':19}received",
            f"{'':30}{'load':8}{'way':10}{'messages':>9}{'lost':>6}{'early':>6}{'swapped':>8}"
            f"{_QUANTILES}{'':4}{_QUANTILES}{'core':>8}",
            *errors,
            "",
            f"{'round trip [ms]':48}{_QUANTILES}",
            *trips,
            *remarks,
        ]
    )


def _packets(mtu: int, protocol: str) -> _Case:
    def open_path(out: Path) -> AbstractContextManager[LinkPath]:
        return packets("constant:20ms", mtu=mtu, protocol=protocol)

    return _Case(f"packets 10 ms, {protocol}, MTU {mtu}", open_path, _ONE_WAY_NS)


def _references() -> tuple[list[_Case], list[str]]:
    """References for the shim on this machine, and remarks on the references that cannot be
    measured.
    """
    cases: list[_Case] = []
    remarks: list[str] = []
    missing = why_not_permitted()
    if missing is None:
        cases += [_packets(1500, "udp"), _packets(65535, "udp"), _packets(1500, "tcp")]
    else:
        remarks.append(f"no packet-level reference: {missing}")
    missing = why_no_kernel()
    if missing is None:
        cases.append(_KERNEL)
    else:
        remarks.append(f"no reference by the kernel: {missing}")
    return cases, ["", *remarks] if remarks else []


def _try(case: _Case, load: str, *, seconds: float, answer: bool = False) -> LinkTrial:
    cores = os.cpu_count() or 1
    with _busy_processes(cores if load == "loaded" else 0):
        return run_trial(case.open_path, seconds=seconds, answer=answer)


@contextmanager
def _busy_processes(count: int) -> Iterator[None]:
    command = python("-c", "while True: pass")
    processes = [subprocess.Popen(command, preexec_fn=end_with_parent()) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _error_lines(case: _Case, load: str, trial: LinkTrial) -> list[str]:
    lines = []
    for direction, name in enumerate(DIRECTIONS):
        way = way_errors(trial, direction, one_way_ns=case.one_way_ns)
        share = "" if direction else f"{trial.processor:8.2f}"
        lines.append(
            f"{case.name:30}{load:8}{name:10}{way.messages:9}{way.lost:6}{way.early:6}"
            f"{way.swapped:8}{_quantiles(way.released_ns)}{'':4}{_quantiles(way.received_ns)}{share}"
        )
    return lines


def _quantiles(times_ns: np.ndarray) -> str:
    if not len(times_ns):
        return f"{'-':>7} {'-':>7} {'-':>7}"
    return " ".join(f"{value * 1e-6:7.3f}" for value in np.percentile(times_ns, [50, 99, 100]))
