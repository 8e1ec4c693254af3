"""Start a stack in the background: the parent process waits only until the stack is ready."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

from shared.errors import LinkError
from shared.process.entry import EXIT_INTERRUPTED

_READY = b"ready"
_ENDING = (signal.SIGINT, signal.SIGTERM)


def in_background(play: Callable[[int], int]) -> int:
    """Run `play(ready_fd)` in a child process with a new session. Return in both processes.

    The child returns the exit code of `play`. The parent returns 0 once the child has called
    `tell_ready(ready_fd, …)`, or the child's exit code if it ends before. Until then the child
    prints to this terminal, and a signal to the parent ends the child too. No thread may have been
    started yet.
    """
    reading, writing = os.pipe()
    sys.stdout.flush()
    # Signals are held back until there is a child to send them to.
    unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    process = os.fork()
    if process == 0:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        os.close(reading)
        os.setsid()
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        return play(writing)
    os.close(writing)

    def end(number: int, frame: FrameType | None) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)

    for number in _ENDING:
        signal.signal(number, end)
    signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
    with os.fdopen(reading, "rb") as reader:
        if reader.read() == _READY:
            return 0
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if code == -signal.SIGTERM:
        return EXIT_INTERRUPTED
    if code < 0:
        raise LinkError(f"the stack was killed (signal {-code}) before it was ready")
    return code


def tell_ready(descriptor: int, errors: int) -> None:
    """Tell the parent process that the stack is ready, and release its terminal.

    From here on, standard error goes to the descriptor `errors`.
    """
    sys.stdout.flush()
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, sys.stdout.fileno())
    os.dup2(errors, sys.stderr.fileno())
    os.close(nothing)
    # The parent may have been killed.
    with contextlib.suppress(BrokenPipeError):
        os.write(descriptor, _READY)
    os.close(descriptor)
