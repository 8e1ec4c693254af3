"""Locks of files, by which a process shows that it lives. The system releases them at its end."""

from __future__ import annotations

import fcntl
import time
from pathlib import Path
from typing import IO

_POLL_SECONDS = 0.01


def lock(file: IO[str] | IO[bytes], *, within: float) -> bool:
    """Lock an open file until it is closed. Return False if others hold it for `within` [s]."""
    deadline = time.monotonic() + within
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL_SECONDS)
        else:
            return True


def is_locked(path: Path) -> bool:
    """Return whether a living process holds the lock of a file; False if there is no such file."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
