"""A stack in the background: whoever starts it waits until it is ready and is then left alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from types import FrameType

_READY = b"ready"


def start_in_background(arguments: Sequence[str]) -> int:
    """Run `deploy.up` with these arguments in a session of its own.

    Returns 0 once it says that it is ready, or its exit code if it ends before. Until then it
    prints to this terminal, and a signal here ends it too.
    """
    told, telling = os.pipe()
    command = [sys.executable, "-m", "deploy.up", *arguments, "--ready-fd", str(telling)]
    process = subprocess.Popen(
        command, pass_fds=[telling], stdin=subprocess.DEVNULL, start_new_session=True
    )
    os.close(telling)

    def end(number: int, frame: FrameType | None) -> None:
        process.terminate()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    with os.fdopen(told, "rb") as reader:
        ready = reader.read() == _READY
    return 0 if ready else process.wait()


def tell_ready(descriptor: int, errors: int) -> None:
    """Say so to whoever waits, and let go of their terminal; what goes wrong goes to `errors`."""
    sys.stdout.flush()
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, sys.stdout.fileno())
    os.dup2(errors, sys.stderr.fileno())
    os.close(nothing)
    os.write(descriptor, _READY)
    os.close(descriptor)
