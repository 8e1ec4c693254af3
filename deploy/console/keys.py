"""Keys in the terminal of a run that send commands to it.

The terminal gives each key at once and shows none, while Ctrl-C still ends the run. Only a process
in the foreground of its terminal may read it.
"""

from __future__ import annotations

import contextlib
import os
import sys
import termios
import tty
from collections.abc import Iterator

from shared.wire.operator.commands import Command
from shared.wire.operator.texts import parse_command

_PUSH = "80N"
_ENTER = ("\n", "\r")
# A key, or the end of the sequence of an arrow key; its command; and its name in the table.
_KEYS = (
    ("\033[A", f"push {_PUSH} +x", "↑"),
    ("\033[B", f"push {_PUSH} -x", "↓"),
    ("\033[D", f"push {_PUSH} +y", "←"),
    ("\033[C", f"push {_PUSH} -y", "→"),
    ("o", "link outage 300ms", "o"),
    ("c", "link cut", "c"),
    ("r", "link restore", "r"),
    ("d", "link delay 80ms", "d"),
    ("1", "controller la", "1"),
    ("2", "controller lc", "2"),
    ("3", "controller pr", "3"),
    (" ", "pause", "space"),
    (".", "step 10", "."),
    ("s", "speed 0.25", "s"),
    ("f", "speed 1", "f"),
    ("g", "resume", "g"),
    ("x", "reset", "x"),
)


def keys_in_words(*, link: bool) -> str:
    """Return the table of keys in lines of at most 76 characters; `link`: the run has a shim."""
    cells = [f"{name} {text}" for _, text, name in _KEYS if link or not text.startswith("link")]
    lines = [""]
    for cell in cells:
        if lines[-1] and len(lines[-1]) + len(cell) + 3 > 66:
            lines.append("")
        lines[-1] += f"{' · ' if lines[-1] else ''}{cell}"
    return "\n".join(f"    keys | {line}" for line in lines)


def commands_of(typed: str) -> tuple[list[Command], bool]:
    """Return the commands of typed keys, and whether Enter is among them."""
    found, enter = [], False
    while typed:
        key = next((key for key, _, _ in _KEYS if typed.startswith(key)), typed[0])
        text = next((text for each, text, _ in _KEYS if each == key), None)
        if text is not None:
            found.append(parse_command(text))
        enter = enter or key in _ENTER
        typed = typed[len(key) :]
    return found, enter


def has_keys() -> bool:
    """Return whether this process may read keys: input and output are its terminal, in the
    foreground.
    """
    try:
        in_front = os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False
    return in_front and sys.stdout.isatty()


@contextlib.contextmanager
def each_key() -> Iterator[None]:
    """Let the terminal give each key at once, without showing it, while the context lasts."""
    file = sys.stdin.fileno()
    try:
        before = termios.tcgetattr(file)
        tty.setcbreak(file, termios.TCSADRAIN)
    except (OSError, termios.error):
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError, termios.error):
            termios.tcsetattr(file, termios.TCSADRAIN, before)


def typed_keys() -> str:
    """Return the keys typed since the last call; empty at the end of the input."""
    with contextlib.suppress(OSError):
        return os.read(sys.stdin.fileno(), 256).decode(errors="ignore")
    return ""
