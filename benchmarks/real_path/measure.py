"""Measure a real path on one machine: robot and edge in two namespaces, a slow cable in between.

Each rate, round trip, protocol, send buffer, loss and cut has a separate run. The table shows the
age of the projectors at their use, and how many the link did not take. The largest age is the
longest silence of the link, as the robot sees it. As root.
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
from shared.config.robot_settings import RobotConfig
from shared.errors import LinkError
from shared.output.versions import versions
from shared.process.cli import EXIT_STANDING
from shared.process.entry import python

_PORT = 7460
_PROTOCOLS = ("tcp", "tls", "quic", "quic-datagram", "udp")
_UNPROTECTED = ("tcp", "udp")
_READY_SECONDS, _STOP_SECONDS = 60.0, 30.0
_TASK_BEGINS = "the task begins"
_UNDISTURBED_SECONDS = 1.0


def add_real_path_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `run_real_path`."""
    parser.add_argument(
        "--rate",
        nargs="+",
        default=["100mbit", "300mbit"],
        help="rates of the cable, in the notation of tc",
    )
    parser.add_argument(
        "--round-trip",
        nargs="+",
        metavar="MS",
        type=float,
        default=[0.0],
        help="round trips of the cable [ms]; above 0 the cable is ./wbc netem packets",
    )
    parser.add_argument(
        "--protocol",
        nargs="+",
        default=["tcp"],
        choices=_PROTOCOLS,
        help="protocols (default tcp); quic-datagram is quic/…?rel=0",
    )
    parser.add_argument(
        "--loss",
        nargs="+",
        metavar="PROBABILITY",
        type=_probability,
        default=[0.0],
        help="probability of losing a packet, each way, after the first second of the task",
    )
    parser.add_argument(
        "--cut",
        nargs="+",
        metavar="S",
        type=float,
        default=[0.0],
        help="time for which the cable carries nothing, after the first second of the task [s]",
    )
    parser.add_argument("--config", metavar="FILE.toml", help="settings of both ends")
    parser.add_argument(
        "--send-buffer",
        nargs="+",
        metavar="BYTES",
        type=_buffer,
        default=[None],
        help="send buffer of the edge's socket, which the kernel doubles (default: the project's)",
    )
    parser.add_argument(
        "--duration", type=float, default=10.0, help="duration of a run [s] (default %(default)g)"
    )
    parser.add_argument(
        "--controller", default="la", help="the robot's controller (default %(default)s)"
    )


def run_real_path(arguments: argparse.Namespace) -> int:
    """Print a row of the table for each case, as it is measured."""
    exit_at_termination()
    found = versions()
    print(f"{found['platform']}, {os.cpu_count()} cores, Zenoh {found['eclipse-zenoh']}\n")
    print(
        "| cable | round trip | over | send buffer | loss | cut | age p50, p99, max ms | sent "
        "| received | lost |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    cases = itertools.product(
        arguments.rate,
        arguments.round_trip,
        arguments.protocol,
        arguments.send_buffer,
        arguments.loss,
        arguments.cut,
    )
    for rate, round_trip_ms, protocol, buffer, loss, cut in cases:
        with _machines(rate, round_trip_ms) as machines, tempfile.TemporaryDirectory() as folder:
            row = _trial(
                machines,
                Path(folder),
                protocol=protocol,
                settings="" if buffer is None else f"#so_sndbuf={buffer}",
                loss=loss,
                cut=cut,
                config=arguments.config,
                duration=arguments.duration,
                controller=arguments.controller,
            )
        cable = f"{rate} | {round_trip_ms:g} ms | {protocol} | {buffer or 'ours'}"
        case = f"{cable} | {loss:g} | {cut:g} s"
        print(f"| {case} | {row} |", flush=True)
    return EXIT_STANDING


def _buffer(text: str) -> int | None:
    if text == "ours":
        return None
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a number of bytes or ours, got {text!r}")
    return int(text)


def _probability(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"expected a probability, 0 ≤ p < 1, got {text}")
    return value


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
    loss: float,
    cut: float,
    config: str | None,
    duration: float,
    controller: str,
) -> str:
    """Play one run. Return age p50, p99 and maximum, and projectors sent, received and lost."""
    endpoint = f"{protocol}/{machines.edge.address}:{_PORT}"
    if protocol == "quic-datagram":
        endpoint = f"quic/{machines.edge.address}:{_PORT}?rel=0"
    secure: tuple[str, ...] = () if config is None else ("--config", config)
    if protocol not in _UNPROTECTED:
        make(folder / "keys", robots=[RobotConfig().name], hosts=[machines.edge.address])
        secure += ("--secure", str(folder / "keys"))
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
            if loss or cut:
                _wait_for_line(moving, folder / "robot.txt", _TASK_BEGINS)
                time.sleep(_UNDISTURBED_SECONDS)
                _disturb(machines, loss=loss, cut=cut)
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
        f"{age['p50']:.1f}, {age['p99']:.1f}, {age['max']:.0f}{fell} | "
        f"{sent['link']['downlink']['sent']} | {down['received']} | {down['lost']}"
    )


def _disturb(machines: Machines, *, loss: float, cut: float) -> None:
    """Cut the cable for `cut` [s], then lose packets with the probability `loss`."""
    ends = (machines.robot, machines.edge)
    if cut:
        for machine in ends:
            machine.drop(1.0)
        time.sleep(cut)
    for machine in ends:
        machine.drop(loss)


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
            raise LinkError(f"no {text!r} in time: {_last_line(output)}")
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
