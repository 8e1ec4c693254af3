"""The kernel's record of a process: /proc/PID/stat."""

from __future__ import annotations

import os
from pathlib import Path

_PROC = Path("/proc")


def process_stat(pid: int, proc: Path = _PROC) -> list[str]:
    """Return the fields after the program's name, the state of the process first.

    Raise `OSError` if there is no such process, or no /proc.
    """
    text = (proc / str(pid) / "stat").read_text(encoding="ascii", errors="replace")
    # The name of the program, in brackets, may have spaces and brackets.
    return text.rpartition(")")[2].split()


def process_started(pid: int) -> int | None:
    """Return when a process started [ticks of the kernel since boot]; None if it is unknown."""
    try:
        return int(process_stat(pid)[19])
    except OSError:
        return None


def processor_seconds(pid: int, proc: Path = _PROC) -> float:
    """Return the processor time of a process so far, user and system [s]."""
    user, system = process_stat(pid, proc)[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
