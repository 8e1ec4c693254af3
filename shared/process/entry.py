"""A process of ours as it begins, and the command line that starts one: the caller's environment
reaches neither.

`enter()` is called by `remote_wbc.begin`, in isolated mode and before numpy and zenoh are imported.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import NoReturn

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130

_LIBRARY_PATH = "LD_LIBRARY_PATH"
# Of those that bring libraries of their own, the ones whose version decides what is computed.
_OWN = ("numpy", "pinocchio", "zenoh")


def python(*arguments: str) -> list[str]:
    """The command line of a Python like this one, isolated, with UTF-8 and unbuffered output."""
    return [sys.executable, "-I", "-X", "utf8", "-u", *arguments]


def enter() -> None:
    """Prepare this process; ends it with one line if a package is not of its own environment."""
    _open_standard_streams()
    end_at_interrupt(EXIT_INTERRUPTED)
    _leave_foreign_libraries()
    import shared.process.native_libraries  # noqa: F401

    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show a character shows another.
        stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    _check_packages()


def end_at_interrupt(code: int) -> None:
    """Have Ctrl-C end this process at once and silently, with an exit code.

    For the time while nothing has begun, or all has ended. Where it is ignored it stays so.
    """

    def end(number: int, frame: FrameType | None) -> NoReturn:
        os._exit(code)

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _open_standard_streams() -> None:
    """Stand-ins for closed ones: else the next file or socket takes a number that is printed to."""
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
    """Start again without the folders of LD_LIBRARY_PATH that hold libraries of a name of ours.

    The loader prefers them to those beside our packages; a workspace of ROS has its own Pinocchio.
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
    """One line and the end if a package is missing or comes from elsewhere."""
    for name in _OWN:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            _refuse(name, "found none")
        elif not Path(spec.origin).is_relative_to(sys.prefix):
            _refuse(name, f"found {spec.origin}")


def _refuse(name: str, found: str) -> NoReturn:
    print(
        f"error: expected the package {name} in {sys.prefix}, {found}; ./deploy/setup installs all "
        "that is needed into .venv, and .venv/bin/python finds it there",
        file=sys.stderr,
    )
    raise SystemExit(EXIT_ERROR)
