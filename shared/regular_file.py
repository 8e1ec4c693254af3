"""Read files of bounded size, and refuse pipes and devices, which may wait or last for ever."""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

_KINDS = ((stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"), (stat.S_ISBLK, "a device"))


def open_regular(path: Path) -> BufferedReader:
    """Open a file for reading.

    Raise `OSError` if it cannot be read or is no regular file. Its `strerror` says why.
    """
    # A pipe without a writer would let `open` wait.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        kind = next((name for holds, name in _KINDS if holds(mode)), "a device")
        reason = f"expected a regular file, got {kind}; write its content to a file first"
        raise OSError(errno.EINVAL, reason, str(path))
    return os.fdopen(descriptor, "rb")


def read_regular(path: Path, *, at_most: int) -> bytes:
    """Return the content of a file of `at_most` bytes; raise `OSError` as `open_regular` does."""
    with open_regular(path) as file:
        data = file.read(at_most + 1)
    if len(data) > at_most:
        reason = f"expected at most {at_most / 1e6:g} MB, got more; is it the right file?"
        raise OSError(errno.EFBIG, reason, str(path))
    return data
