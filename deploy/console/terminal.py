"""Print the services' lines, each after the service's name, and a status line below them.

On a terminal the status line stays last and is rewritten in place. Elsewhere it is printed every
second if it has changed, and nothing is coloured. All lines also go to a `copy`, which `logs`
reads.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import time

from deploy.background.state import LineFile
from shared.output.screen import rewrites_lines

_COLOURS = {
    "edge": "\033[34m",
    "netem": "\033[33m",
    "robot": "\033[32m",
    "viewer": "\033[35m",
    "router": "\033[36m",
}
_RESET, _CLEAR_LINE = "\033[0m", "\r\033[2K"
_PLAIN_SECONDS, _COPY_SECONDS = 1.0, 10.0
_SAID = re.compile(r" *([a-z0-9_-]+) \| (.*)")


class Terminal:
    """Prints services' lines with their name; keeps the status line last."""

    def __init__(self, copy: LineFile | None = None) -> None:
        self._copy = copy
        self._live = rewrites_lines(sys.stdout)
        # https://no-color.org
        self._coloured = self._live and not os.environ.get("NO_COLOR")
        self._quiet = False
        self._status = ""
        self._last_plain, self._last_copied = 0.0, time.monotonic()

    @property
    def columns(self) -> int:
        """The maximum length of a status line [characters]."""
        return shutil.get_terminal_size().columns - 1 if self._live else 160

    def say(self, name: str, line: str) -> None:
        """Print a line of a service."""
        plain = f"{name:>6} | {line}"
        if self._live:
            label = f"{name:>6} │"
            if self._coloured:
                label = f"{_COLOURS.get(name, '')}{label}{_RESET}"
            self._print(f"{label} {line}")
        else:
            self._print(plain)
        self._keep(plain)

    def tell(self, text: str) -> None:
        """Print whole lines that belong to no service."""
        self._print(text)
        self._keep(text)

    def note(self, text: str) -> None:
        """Write a line into the copy only."""
        self._keep(text)

    def show(self, status: str) -> None:
        """Print the status line: in place on a terminal, elsewhere every second if it changes."""
        now = time.monotonic()
        if now - self._last_copied >= _COPY_SECONDS:
            self._last_copied = now
            self._keep(f"status | {status}")
        if self._quiet:
            return
        if self._live:
            self._status = status[: self.columns]
            self._write(f"{_CLEAR_LINE}{self._status}")
        elif now - self._last_plain >= _PLAIN_SECONDS and status != self._status:
            self._last_plain, self._status = now, status
            self._write(f"status | {status}\n")

    def clear(self) -> None:
        """Remove the status line."""
        if self._live and self._status:
            self._write(_CLEAR_LINE)
        self._status = ""

    def leave(self) -> None:
        """Stop printing to the terminal; the copy goes on."""
        self.clear()
        self._quiet = True

    def _print(self, text: str) -> None:
        if not self._quiet:
            self._write(f"{_CLEAR_LINE}{text}\n{self._status}" if self._live else f"{text}\n")

    def _write(self, text: str) -> None:
        try:
            print(text, end="", flush=True)
        except OSError:
            if self._copy is None:
                raise
            # The reader has left or the terminal was closed. The run goes on.
            self._quiet = True
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def _keep(self, text: str) -> None:
        if self._copy is not None:
            self._copy.add(text)


def service_line(line: str) -> tuple[str, str] | None:
    """Split a line of a copy into service and text; None for a line of no service."""
    match = _SAID.fullmatch(line)
    return None if match is None else (match[1], match[2])
