"""The beginning of every command: `begin(__name__)` stands before all other imports of its module.

This module is at the top because its name is the project's own: a folder `shared` or `deploy` of
the caller's, or one in PYTHONPATH, may hide ours until `begin` has returned.
"""

from __future__ import annotations

import os
import signal
import sys


def begin(name: str) -> None:
    """Make this process independent of its caller's environment, if `name` is `__main__`.

    Python starts again in isolated mode (`-I`) if it is not in it: without the current folder,
    PYTHONPATH and other PYTHON… variables, and the user's own packages. Then
    `shared.process.entry.enter`.
    """
    if name != "__main__":
        return
    if not sys.flags.isolated:
        # The first place is the current folder's.
        if os.path.dirname(os.path.abspath(__file__)) not in sys.path[1:]:
            sys.exit(_not_installed())
        # A Ctrl-C that comes while Python starts is kept until it can be answered.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        os.execv(sys.executable, [sys.executable, "-I", *sys.orig_argv[1:]])
    from shared.process.entry import enter

    enter()


def _not_installed() -> int:
    print(
        f"error: expected a Python that this project is installed in, got {sys.executable}; "
        "./deploy/setup installs it into .venv: use .venv/bin/python",
        file=sys.stderr,
    )
    return 2
