"""Effect of a flood of commands on the robot: ticks with the flood and without it, in turn.

One live run has a quiet span and a flooded span in each round. In a flooded span some clients send
commands one after the other, as fast as the stack answers: good ones to robot and shim, and bad
ones. The ratio of a flooded span to the quiet one before it tells what the flood does. The ratio of
a quiet span to the quiet one of the round before tells what the machine does by itself.
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.live_stack import live_stack
from benchmarks.timing import Ratio, cores_busy, header_of_processes
from deploy.background.control_client import StackClient
from deploy.background.state import StackFolder
from shared.errors import LinkError
from shared.output.text_table import aligned
from shared.telemetry.parquet import read_parquet
from shared.wire.operator.texts import parse_command

_CLIENTS = 4
# The last one is refused, because the robot does not step.
_COMMANDS = tuple(parse_command(text) for text in ("resume", "link delay 0ms", "go 1 0 0deg"))
_SETTLED = 4.0
Span = tuple[int, int]


def run(*, rounds: int, seconds: float) -> str:
    """Play `rounds` of a quiet and a flooded span of `seconds` each. Return the result as text.

    Raise `LinkError` if the stack does not start or does not end.
    """
    busy = cores_busy(seconds=2.0)
    how = ("--stay", "--controller", "lc", "--push", "none", "--view", "off")
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name:
        with live_stack(Path(name), *how) as stack:
            stack.ready()
            time.sleep(_SETTLED)
            quiet, flooded, sent = _flood(StackFolder(stack.run), rounds=rounds, seconds=seconds)
        if stack.up.returncode < 0:
            raise LinkError("the stack did not end by itself, and was killed")
        schema, rows = read_parquet(stack.run / "telemetry.parquet")
    wall_ns, tick_ns, late_ns = (
        schema.column(rows, key) for key in ("wall_ns", "tick_ns", "late_ns")
    )
    lines = [["", "p50", "p99", "quiet / quiet, p50", "p99"]]
    for title, values in (("computing time of a tick", tick_ns), ("beginning of a tick", late_ns)):
        still, under = (
            [values[slice(*np.searchsorted(wall_ns, span))] for span in spans]
            for spans in (quiet, flooded)
        )
        ratio, control = Ratio.of(under, still), Ratio.of(still[1:], still[:-1])
        lines.append([title, ratio.p50_text, f"{ratio.p99:.2f}", control.p50_text])
        lines[-1].append(f"{control.p99:.2f}")
    return "\n".join(
        [
            header_of_processes(busy),
            f"balance with LC, {rounds} rounds of {seconds:g} s quiet and as long flooded by "
            f"{_CLIENTS} clients, {sent / (rounds * seconds):.0f} commands a second",
            "ratios: flooded / quiet",
            "",
            *aligned(lines, left=1),
        ]
    )


def _flood(
    stack: StackFolder, *, rounds: int, seconds: float
) -> tuple[list[Span], list[Span], int]:
    """Return the quiet and the flooded spans on the monotonic clock [ns], and the commands sent."""
    quiet, flooded, sent = [], [], 0
    for _ in range(rounds):
        began_ns = time.monotonic_ns()
        time.sleep(seconds)
        quiet.append((began_ns, time.monotonic_ns()))
        ended = threading.Event()
        counts = [0] * _CLIENTS
        clients = [
            threading.Thread(target=_send, args=(stack, counts, k, ended)) for k in range(_CLIENTS)
        ]
        for client in clients:
            client.start()
        began_ns = time.monotonic_ns()
        time.sleep(seconds)
        flooded.append((began_ns, time.monotonic_ns()))
        ended.set()
        for client in clients:
            client.join()
        sent += sum(counts)
    return quiet, flooded, sent


def _send(stack: StackFolder, counts: list[int], own: int, ended: threading.Event) -> None:
    client = StackClient(stack)
    for command in itertools.cycle(_COMMANDS):
        if ended.is_set():
            return
        with contextlib.suppress(LinkError):  # refused, as much of a flood
            client.send(command)
        counts[own] += 1
