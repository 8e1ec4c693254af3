"""Whether there is a screen that a window could open on."""

from __future__ import annotations

import os
import sys


def has_screen() -> bool:
    """On Linux a display server says so; elsewhere there is one."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in displays)
