"""Whether there is a screen that a window could open on, and a terminal that can rewrite a line."""

from __future__ import annotations

import os
import sys
from typing import TextIO


def has_screen() -> bool:
    """On Linux a display server says so; elsewhere there is one."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in displays)


def rewrites_lines(stream: TextIO) -> bool:
    """Whether a line that was written can be written again in its place."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"
