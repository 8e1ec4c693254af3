"""Check for a screen that can show a window, and for a terminal that can rewrite a line."""

from __future__ import annotations

import os
import sys
from typing import TextIO


def has_screen() -> bool:
    """Return whether there is a screen: on Linux if a display server runs, elsewhere always."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in displays)


def rewrites_lines(stream: TextIO) -> bool:
    """Return whether a line that was written can be written again in its place."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"
