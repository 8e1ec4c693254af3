"""Measure a real path on one machine: robot and edge in two namespaces, a slow cable in between.

Each rate, round trip, protocol and send buffer has a separate run. The table shows the age of the
projectors at their use, and how many the link did not take. As root.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.real_path.long_cable import machines_on_long_cable
from benchmarks.real_path.namespaces import Machine, Machines, two_machines
from benchmarks.termination import exit_at_termination
from deploy.keys import make
from shared.config.settings import RobotConfig
from shared.errors import LinkError
from shared.output.versions import versions
from shared.process.cli import EXIT_STANDING
from shared.process.entry import python

_PORT = 7460
_READY_SECONDS, _STOP_SECONDS = 60.0, 30.0


def add_real_path_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `run_real_path`."""
    parser.add_argument("--rate", nargs="+", default=["100mbit", "300mbit"], help="as tc writes it")
    parser.add_argument(
        "--round-trip",
        nargs="+",
        metavar="MS",
        type=float,
        default=[0.0],
        help="of the cable [ms]; not 0: it is ./wbc netem packets",
    )
    parser.add_argument("--protocol", nargs="+", default=["tcp"], choices=("tcp", "tls", "quic"))
    parser.add_argument(
        "--send-buffer",
        nargs="+",
        metavar="BYTES",
        type=_buffer,
        default=[None],
        help="of the edge's socket; the kernel doubles it (default: ours)",
    )
    parser.add_argument("--duration", type=float, default=10.0, help="[s] (default %(default)s)")
    parser.add_argument("--controller", default="la", help="(default %(default)s)")


def run_real_path(arguments: argparse.Namespace) -> int:
    """Print a row of the table for each case, as it is measured."""
    exit_at_termination()
    found = versions()
    print(f"{found['platform']}, {os.cpu_count()} cores, Zenoh {found['eclipse-zenoh']}\n")
    print("| cable | round trip | over | send buffer | age p50, p99 ms | sent | received | lost |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    cases = itertools.product(
        arguments.rate, arguments.round_trip, arguments.protocol, arguments.send_buffer
    )
    for rate, round_trip_ms, protocol, buffer in cases:
        with _machines(rate, round_trip_ms) as machines, tempfile.TemporaryDirectory() as folder:
            row = _trial(
                machines,
                Path(folder),
                protocol=protocol,
                settings="" if buffer is None else f"#so_sndbuf={buffer}",
                duration=arguments.duration,
                controller=arguments.controller,
            )
        case = f"{rate} | {round_trip_ms:g} ms | {protocol} | {buffer or 'ours'}"
        print(f"| {case} | {row} |", flush=True)
    return EXIT_STANDING


def _buffer(text: str) -> int | None:
    if text == "ours":
        return None
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a number of bytes or ours, got {text!r}")
    return int(text)


def _machines(rate: str, round_trip_ms: float) -> contextlib.AbstractContextManager[Machines]:
    if round_trip_ms == 0.0:
        return two_machines(rate=rate)
    return machines_on_long_cable(rate=rate, round_trip_ms=round_trip_ms)


def _trial(
    machines: Machines,
    folder: Path,
    *,
    protocol: str,
    settings: str,
    duration: float,
    controller: str,
) -> str:
    """Play one run. Return age p50 and p99, and projectors sent, received and lost."""
    endpoint = f"{protocol}/{machines.edge.address}:{_PORT}"
    secure: tuple[str, ...] = ()
    if protocol != "tcp":
        make(folder / "keys", robots=[RobotConfig().name], hosts=[machines.edge.address])
        secure = ("--secure", str(folder / "keys"))
    there, here = folder / "edge", folder / "robot"
    serving = _start(
        machines.edge,
        folder / "edge.txt",
        *("--only", "edge", "--listen", endpoint + settings, "--out", str(there), *secure),
    )
    try:
        _wait_for_line(serving, folder / "edge.txt", "READY")
        moving = _start(
            machines.robot,
            folder / "robot.txt",
            *("--only", "robot", "--edge", endpoint, "--out", str(here), "--push", "none"),
            *("--duration", str(duration), "--controller", controller, *secure),
        )
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                moving.wait(timeout=_READY_SECONDS + 2.0 * duration)
        finally:
            _end(moving)
    finally:
        _end(serving)
    try:
        report, sent = _load(here / "summary.json"), _load(there / "edge.json")
    except OSError:
        raise LinkError(f"the robot left no summary: {_last_line(folder / 'robot.txt')}") from None
    age, down = report["projector_age_ms"], report["link"]["downlink"]
    fell = " (fell)" if report["fell"] else ""
    return (
        f"{age['p50']:.1f}, {age['p99']:.1f}{fell} | {sent['link']['downlink']['sent']} | "
        f"{down['received']} | {down['lost']}"
    )


def _start(machine: Machine, output: Path, *flags: str) -> subprocess.Popen[bytes]:
    command = machine.command(*python("-m", "deploy", "up", *flags))
    with output.open("wb") as file:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT
        )


def _wait_for_line(process: subprocess.Popen[bytes], output: Path, text: str) -> None:
    deadline = time.monotonic() + _READY_SECONDS
    while text not in output.read_text(encoding="utf-8", errors="replace"):
        if process.poll() is not None or time.monotonic() > deadline:
            raise LinkError(f"the edge did not start: {_last_line(output)}")
        time.sleep(0.1)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
    try:
        process.wait(timeout=_STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _load(path: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded


def _last_line(path: Path) -> str:
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), "it said nothing")
