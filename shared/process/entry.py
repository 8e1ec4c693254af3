"""Separate a process of the project from its caller's environment, and start such processes.

`remote_wbc.begin` calls `enter()`, in isolated mode and before numpy and zenoh are imported.
"""

from __future__ import annotations

import _thread
import contextlib
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import NoReturn

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130

_PR_SET_PDEATHSIG = 1

# Until an interrupt looks again whether the import that it came in has ended.
_IMPORT_POLL_SECONDS = 0.02

_LIBRARY_PATH = "LD_LIBRARY_PATH"
# The packages with native libraries whose versions decide the results.
_OWN = ("numpy", "pinocchio", "zenoh")


def python(*arguments: str) -> list[str]:
    """Return the command line of this Python, isolated, with UTF-8 and unbuffered output."""
    return [sys.executable, "-I", "-X", "utf8", "-u", *arguments]


def end_with_parent() -> Callable[[], None] | None:
    """Return the `preexec_fn` of a child that gets SIGTERM when its parent ends, even if killed.

    It is None on systems without such a signal.
    """
    if sys.platform != "linux":
        return None
    # Imported here: most processes start no child.
    import ctypes

    # Loaded before the fork: after it, another thread may hold the loader's lock for ever.
    prctl = ctypes.CDLL(None).prctl

    def ask() -> None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)

    return ask


def enter() -> None:
    """Prepare this process; end it with one line if a package is not of this environment."""
    _open_standard_streams()
    end_at_interrupt(EXIT_INTERRUPTED)
    _leave_foreign_libraries()
    import shared.process.native_libraries  # noqa: F401

    for stream in (sys.stdout, sys.stderr):
        # A character that the terminal cannot show is replaced.
        stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    _check_packages()


def end_at_interrupt(code: int) -> None:
    """Make Ctrl-C end this process at once and silently, with an exit code.

    This is for the time before a command begins and after its end. If Ctrl-C is ignored, it stays
    ignored.
    """

    def end(number: int, frame: FrameType | None) -> NoReturn:
        os._exit(code)

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def raise_at_interrupt() -> None:
    """Make Ctrl-C raise `KeyboardInterrupt`, after the import that it comes in, if any.

    A native module that is being imported turns the exception into another one, or aborts the
    process.
    """
    signal.signal(signal.SIGINT, _raise_or_wait)


@contextlib.contextmanager
def nothing_begun() -> Iterator[None]:
    """Let Ctrl-C end this process at once where it would raise `KeyboardInterrupt` outside."""
    if signal.getsignal(signal.SIGINT) is not _raise_or_wait:
        yield
        return
    end_at_interrupt(EXIT_INTERRUPTED)
    try:
        yield
    finally:
        raise_at_interrupt()


def _raise_or_wait(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            # No lock of `threading` is taken: the main thread may hold it.
            _thread.start_new_thread(_interrupt_again, ())
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _interrupt_again() -> None:
    time.sleep(_IMPORT_POLL_SECONDS)
    os.kill(os.getpid(), signal.SIGINT)


def _open_standard_streams() -> None:
    """Open the null device in place of closed standard streams.

    Otherwise the next file or socket takes the number of a stream, and prints go into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8")  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8")  # noqa: SIM115


def _leave_foreign_libraries() -> None:
    """Start again without the folders of LD_LIBRARY_PATH that would replace a package's library.

    The loader prefers a library there to one of the same name beside a package. A workspace of ROS,
    for example, has its own Pinocchio.
    """
    folders = os.environ.get(_LIBRARY_PATH, "").split(":")
    if folders == [""]:
        return
    ours = {library.name for folder in _library_folders() for library in folder.glob("lib*.so*")}
    kept = [each for each in folders if each and ours.isdisjoint(_names_in(each))]
    if kept == folders:
        return
    os.environ[_LIBRARY_PATH] = ":".join(kept)
    if not kept:
        del os.environ[_LIBRARY_PATH]
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def _library_folders() -> list[Path]:
    found = []
    for package, folder in (("cmeel", "../cmeel.prefix/lib"), ("mujoco", "."), ("zenoh", ".")):
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.origin is not None:
            found.append(Path(spec.origin).parent / folder)
    return found


def _names_in(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _check_packages() -> None:
    """End the process with one line if a package is missing or of another environment."""
    for name in _OWN:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            _refuse(name, "found none")
        elif not Path(spec.origin).is_relative_to(sys.prefix):
            _refuse(name, f"found {spec.origin}")


def _refuse(name: str, found: str) -> NoReturn:
    print(
        f"error: expected the package {name} in {sys.prefix}, {found}; run ./deploy/setup, which "
        "installs all packages into .venv, and use .venv/bin/python",
        file=sys.stderr,
    )
    raise SystemExit(EXIT_ERROR)
