"""Checks for a screen and for a terminal that rewrites lines, and a status line."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from typing import TextIO

_CLEAR_LINE = "\r\033[2K"
_TERMINAL_SECONDS, _PLAIN_SECONDS = 0.25, 10.0


def has_screen() -> bool:
    """Return whether there is a screen: on Linux if a display server runs, elsewhere always."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in displays)


def rewrites_lines(stream: TextIO) -> bool:
    """Return whether a stream can rewrite its last line in place."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"


class StatusLine:
    """A thread that prints the text of `line` while its context lasts.

    On a terminal it rewrites the line in place, else it prints one every ten seconds. The first
    comes after `quiet` [s]. At the end a line that `stays` is printed once more, and any other is
    removed from the terminal. A stream that cannot be written ends the lines, and nothing else.
    """

    def __init__(
        self, line: Callable[[], str], *, stream: TextIO, quiet: float = 0.0, stays: bool = False
    ) -> None:
        self._line = line
        self._stream = stream
        self._quiet = quiet
        self._stays = stays
        self._in_place = rewrites_lines(stream)
        self._begun = False
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="status", daemon=True)

    def __enter__(self) -> StatusLine:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._done.set()
        self._thread.join(timeout=1.0)
        if self._stays:
            self._write(f"{self._shown()}\n")
        elif self._in_place and self._begun:
            self._write(_CLEAR_LINE)

    def _watch(self) -> None:
        end = "" if self._in_place else "\n"
        seconds = _TERMINAL_SECONDS if self._in_place else _PLAIN_SECONDS
        wait = max(self._quiet, seconds)
        while not self._done.wait(wait):
            self._begun, wait = True, seconds
            if not self._write(f"{self._shown()}{end}"):
                return

    def _shown(self) -> str:
        return f"{_CLEAR_LINE if self._in_place else ''}{self._line()}"

    def _write(self, text: str) -> bool:
        """Write a text. Return whether the stream can be written."""
        try:
            print(text, end="", file=self._stream, flush=True)
        except OSError:
            return False
        return True
