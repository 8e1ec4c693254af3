"""A child process with a separate process group. It gets a signal to end when its parent ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from asyncio.subprocess import Process
from collections.abc import Sequence

from shared.process.entry import end_with_parent


async def start_process(command: Sequence[str], *, held: bool = False) -> Process:
    """Start a process without input. Its standard error goes to its `stdout` too.

    With `held` it has an input, which ends when `stdin` is closed.
    """
    return await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.PIPE if held else asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=end_with_parent(),
    )


def terminate(process: Process) -> None:
    """Send SIGTERM to a process and its group, unless the process has ended."""
    if process.returncode is None:
        _signal_group(process, signal.SIGTERM)


def kill_group(process: Process) -> None:
    """Kill a process and all processes of its group.

    If the process has ended, call this at once: later its number may belong to another process.
    """
    _signal_group(process, signal.SIGKILL)


def _signal_group(process: Process, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)
