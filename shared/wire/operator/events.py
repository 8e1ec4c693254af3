"""Events: commands with the task times of their effects, and the file of a run's events.

The file `events.txt` of a run has one event a line, `2.500s link cut`. A script has the same form.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from shared.config.quantities import parse_duration_ns
from shared.errors import ConfigError
from shared.regular_file import read_regular
from shared.wire.operator.commands import TICK_NS, Command
from shared.wire.operator.texts import parse_command

EVENTS_FILE = "events.txt"
# The script of a run has the planned commands. `events.txt` has the carried-out ones.
SCRIPT_FILE = "script.txt"
_MAX_FILE_BYTES = 10_000_000


@dataclass(frozen=True)
class CommandEvent:
    """A command that takes effect with the tick of the task time `time_ns`, whole milliseconds."""

    time_ns: int
    command: Command

    def __str__(self) -> str:
        return f"{self.time_ns * 1e-9:.3f}s {self.command}"


def parse_event(text: str) -> CommandEvent:
    """`2.500s link cut` → the command, at that time of the task, rounded up to a tick."""
    at, _, command = text.strip().partition(" ")
    time_ns = parse_duration_ns(at)
    return CommandEvent(-(-time_ns // TICK_NS) * TICK_NS, parse_command(command))


def read_events(path: Path) -> tuple[CommandEvent, ...]:
    """Return the events of a file in the order of their times. Raise `ConfigError` with the line
    that cannot be used.

    Empty lines and lines that begin with # are left out.
    """
    try:
        text = read_regular(path, at_most=_MAX_FILE_BYTES).decode(errors="replace")
    except OSError as error:
        raise ConfigError(f"events: cannot read {path}: {error.strerror or error}") from None
    events = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            events.append(parse_event(line))
        except ConfigError as error:
            raise ConfigError(f"events: {path}, line {number}: {error}") from None
    return tuple(sorted(events, key=lambda event: event.time_ns))


def write_events(path: Path, events: Iterable[CommandEvent]) -> None:
    """Write events as `read_events` reads them. Raise `OSError` if the file cannot be written."""
    path.write_text("".join(f"{event}\n" for event in events), encoding="utf-8")
