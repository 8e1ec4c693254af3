"""A session of random commands to a live stack, and the same run again in lockstep.

Every one or two seconds a command comes from a seeded generator: pushes, changes of the link, the
controller and the pace, resets. The next command mends a cut link. After a fall the robot is put on
its feet. The result has the commands by kind, the number of falls, and the memory of each service
at the beginning and at the end. It says whether the run's record plays again to the same events at
the same times.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.live_stack import live_stack
from benchmarks.timing import cores_busy, header_of_processes
from deploy.background.control_client import StackClient
from deploy.background.state import StackFolder
from shared.errors import LinkError
from shared.output.text_table import aligned
from shared.process.entry import python
from shared.wire.operator.commands import Command, Reset
from shared.wire.operator.events import EVENTS_FILE, read_events
from shared.wire.operator.texts import parse_command

# Between two commands [s].
_LEAST, _MOST = 0.5, 2.0
# Services have taken the memory that they work with by then [s].
_SETTLED = 20.0
_DIRECTIONS = ("+x", "-x", "+y", "-y", "+x+y", "+x-y", "-x+y", "-x-y")
_FELL = "the robot has fallen"


def commands(seed: int) -> Iterator[tuple[Command, float]]:
    """Yield commands without an end, each with the time until the next one [s].

    A later command undoes the disturbance of an earlier one, for example a cut link or a pause.
    """
    random = np.random.default_rng(seed)
    mending = {"link cut": "link restore", "pause": "resume", "speed 0.5": "speed 1"}
    after = ""
    while True:
        text, after = (after, "") if after else (_any(random), "")
        after = mending.get(text, "")
        yield parse_command(text), float(random.uniform(_LEAST, _MOST))


def _any(random: np.random.Generator) -> str:
    texts = {
        "push": f"push {random.integers(10, 50)}N {random.choice(_DIRECTIONS)}",
        "cut": "link cut",
        "outage": f"link outage {random.integers(20, 300)}ms",
        "delay": f"link delay {random.integers(0, 40)}ms",
        "loss": f"link loss {random.integers(0, 20)}%",
        "profile": f"link profile factory/{random.integers(1, 12):03d}",
        "restore": "link restore",
        "controller": f"controller {random.choice(['la', 'lc'])}",
        "pause": "pause",
        "speed": "speed 0.5",
        "reset": "reset",
    }
    weights = np.array([4.0 if name == "push" else 1.0 for name in texts])
    return str(texts[random.choice(list(texts), p=weights / weights.sum())])


@dataclass
class Session:
    """Counts of commands by their first words, refusals, the number of falls, memory [MB]."""

    sent: Counter[str]
    refused: list[str]
    falls: int
    memory: dict[str, list[float]]


def run(*, seed: int, minutes: float, folder: Path | None) -> str:
    """Play a session and its record again. Return the result as text.

    Raise `LinkError` if the stack does not start or does not end.
    """
    busy = cores_busy(seconds=2.0)
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name:
        how = ("--stay", "--controller", "lc", "--push", "none", "--view", "off")
        with live_stack(Path(name) if folder is None else folder, *how) as stack:
            names = [each.name for each in stack.ready().services]
            session = _send(StackFolder(stack.run), names, seed=seed, seconds=60.0 * minutes)
        if stack.up.returncode < 0:
            raise LinkError("the stack did not end by itself, and was killed")
        return "\n".join(
            [
                header_of_processes(busy),
                f"random commands for {minutes:g} min, seed {seed}; balance with LC, factory/001",
                "",
                *_in_words(session),
                *_played_again(stack.run, Path(name) / "again"),
            ]
        )


def _send(stack: StackFolder, services: list[str], *, seed: int, seconds: float) -> Session:
    client = StackClient(stack)
    session = Session(Counter(), [], 0, {name: [] for name in services})
    began = looked = time.monotonic()
    for command, pause in commands(seed):
        time.sleep(pause)
        now = time.monotonic()
        if now - began > seconds:
            return session
        if now - looked > 1.0 and now - began > min(_SETTLED, seconds / 4):
            looked = now
            for service in stack.read().services:
                session.memory[service.name].append(_memory(service.pid))
        try:
            client.send(command)
            session.sent[_kind(command)] += 1
        except LinkError as error:
            if _FELL in str(error):
                session.falls += 1
                client.send(Reset())
            else:
                session.refused.append(str(error))
    raise AssertionError


def _kind(command: Command) -> str:
    """Return the words of a command without its values."""
    first, second, *_ = f"{command} ".split(" ")
    return f"{first} {second}" if first == "link" else first


def _memory(pid: int) -> float:
    """Return the memory of a process [MB]; 0 if it has ended."""
    try:
        for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
    except OSError:
        pass
    return 0.0


def _in_words(session: Session) -> list[str]:
    lines = [["", "memory at the beginning", "at the end", "most"]]
    for name, memory in session.memory.items():
        if memory:
            part = max(1, len(memory) // 5)
            first, last = np.mean(memory[:part]), np.mean(memory[-part:])
            lines.append([name, f"{first:.1f} MB", f"{last:.1f} MB", f"{max(memory):.1f} MB"])
    kinds = ", ".join(f"{count} {name}" for name, count in session.sent.most_common())
    refused = "; ".join(dict.fromkeys(session.refused)) or "none"
    return [
        f"carried out: {session.sent.total()} ({kinds})",
        f"refused: {len(session.refused)} ({refused})",
        f"falls: {session.falls}",
        "",
        *aligned(lines, left=1),
        "",
    ]


def _played_again(run_folder: Path, again: Path) -> list[str]:
    """Play the record of a run in lockstep. Return the comparison of the events."""
    command = python("-m", "remote_wbc", "trial", "--events", str(run_folder), "--out", str(again))
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    summary = next(iter(done.stdout.splitlines()), done.stderr.strip())
    live = read_events(run_folder / EVENTS_FILE)
    file = again / EVENTS_FILE
    lockstep = read_events(file) if file.exists() else ()
    same = sum(one == other for one, other in zip(live, lockstep, strict=False))
    return [f"again in lockstep: {same} of {len(live)} events at the same times; {summary}"]
