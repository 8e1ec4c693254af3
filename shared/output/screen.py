"""Checks for a screen and for a terminal that rewrites lines, and a status line."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from typing import TextIO

_CLEAR_LINE = "\r\033[2K"
_TERMINAL_SECONDS, _PLAIN_SECONDS = 0.25, 5.0


def has_screen() -> bool:
    """Return whether there is a screen: on Linux if a display server runs, elsewhere always."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in displays)


def rewrites_lines(stream: TextIO) -> bool:
    """Return whether a stream can rewrite its last line in place."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"


class StatusLine:
    """A thread that prints the text of `line` while its context lasts.

    On a terminal it rewrites the line in place, else it prints one every five seconds. The first
    comes after `quiet` [s]. A stream that cannot be written ends the lines, and nothing else.
    """

    def __init__(self, line: Callable[[], str], *, stream: TextIO, quiet: float = 0.0) -> None:
        self._line = line
        self._stream = stream
        self._quiet = quiet
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
        if self._in_place and self._begun:
            print(_CLEAR_LINE, end="", file=self._stream, flush=True)

    def _watch(self) -> None:
        start, end = (_CLEAR_LINE, "") if self._in_place else ("", "\n")
        seconds = _TERMINAL_SECONDS if self._in_place else _PLAIN_SECONDS
        wait = max(self._quiet, seconds)
        while not self._done.wait(wait):
            self._begun, wait = True, seconds
            try:
                print(f"{start}{self._line()}", end=end, file=self._stream, flush=True)
            except OSError:
                return
