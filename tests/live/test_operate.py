"""Commands to a stack that runs in a terminal: their effects, their record, and its end."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from deploy.background.state import StackFolder
from shared.process.entry import python
from shared.wire.operator.commands import Cut, Restore
from shared.wire.operator.events import CommandEvent, parse_event, read_events
from tests.processes import Process, descendants_naming, played, until

pytestmark = pytest.mark.live

Start = Callable[..., Process]
MS = 1_000_000
SCRIPT = ("0.700s push 20N +x --for 10ms", "0.750s link delay 1ms")
QUIET = ("--controller", "lc", "--network", "constant:10ms", "--push", "none", "--view", "off")


def told(run: Path, *command: str) -> subprocess.CompletedProcess[str]:
    return played(*python("-m", "deploy", *command, "--run", str(run)))


def test_a_running_stack_takes_commands_and_records_them_until_it_is_ended_at_once(
    start: Start, tmp_path: Path
) -> None:
    run, script = tmp_path / "run", tmp_path / "script.txt"
    script.write_text("".join(f"{each}\n" for each in SCRIPT))
    up = start(
        "deploy",
        "up",
        "--stay",
        *QUIET,
        "--duration",
        "0.1",
        "--out",
        str(run),
        "--events",
        str(script),
    )
    up.wait_for("the task begins")
    up.wait_for("operator: link delay 1ms")
    commands = (
        ("push", "50N", "-y", "--for", "100ms"),
        ("link", "cut"),
        ("link", "restore"),
        ("speed", "0.5"),
        ("pause",),
        ("step", "5"),
        ("resume",),
        ("reset",),
    )
    said = [told(run, *each) for each in commands]
    assert [each.returncode for each in said] == [0] * len(commands), said
    assert said[0].stdout.startswith("push 50N -y --for 100ms: from ")
    assert "the link's delays scale with it; the edge's" in said[3].stdout
    refused = told(run, "link", "profile", "factory/999")
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
    assert "no such profile" in refused.stderr

    up.wait_for("operator: reset")
    recorded = len(SCRIPT) + len(commands)
    until(lambda: len(read_events(run / "events.txt")) == recorded, "not all are recorded")
    # Robot and shim know the times of a script before the start.
    pushed, delayed, *events = read_events(run / "events.txt")
    assert str(pushed) == SCRIPT[0]
    assert str(delayed.command) == "link delay 1ms"
    assert delayed.time_ns >= parse_event(SCRIPT[1]).time_ns
    texts = [str(event.command) for event in events]
    assert texts == [" ".join(each) for each in commands]
    times = {text: event.time_ns for text, event in zip(texts, events, strict=True)}
    # Simulated time stood still but for the five ticks.
    assert times["step 5"] == times["pause"]
    assert times["resume"] == times["pause"] + 5 * MS
    assert CommandEvent(times["link cut"], Cut()) in events
    assert CommandEvent(times["link restore"], Restore()) in events
    # It is longer in its task than its settings say: it stays.
    assert times["reset"] > 100 * MS

    (edge,) = (each.pid for each in StackFolder(run).read().services if each.name == "edge")
    os.kill(edge, signal.SIGSTOP)
    up.signal(signal.SIGINT)
    up.wait_for("waits for edge (pid")
    up.signal(signal.SIGINT)
    assert up.wait() == 130, up.output
    assert "ended at once" in up.output
    until(lambda: not descendants_naming(str(run)), "processes are left")
    state = StackFolder(run).read()
    assert (state.state, state.exit_code) == ("ended", 130)
