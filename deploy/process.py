"""A process with a group of its own, which ends when whoever started it does."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import sys
from asyncio.subprocess import Process
from collections.abc import Sequence

_PR_SET_PDEATHSIG = 1
# Loaded here: between fork and exec another thread may hold the loader's lock for ever.
_LIBC = ctypes.CDLL(None)


async def start_process(command: Sequence[str], *, held: bool = False) -> Process:
    """Start it without input; both its outputs are its `stdout`.

    With `held` its input ends when `stdin` is closed.
    """
    return await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.PIPE if held else asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=_die_with_parent if sys.platform == "linux" else None,
    )


def terminate(process: Process) -> None:
    """Tell it and its group to end, if it has not."""
    if process.returncode is None:
        _signal_group(process, signal.SIGTERM)


def kill_group(process: Process) -> None:
    """Kill it and what it has left behind in its group. Soon after its end, if it has ended: later
    its number may be another's.
    """
    _signal_group(process, signal.SIGKILL)


def _signal_group(process: Process, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


def _die_with_parent() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
