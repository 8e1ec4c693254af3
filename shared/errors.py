"""Every error that this project raises on purpose.

A user's mistake is a `UserError`. Entry points print it as one line, without a traceback, and exit
with code 2. A message that fails a check is a `MessageRefused`. It is counted under its reason and
dropped.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path


class UserError(Exception):
    """A user's mistake. The message gives the expected value, the value that came, and a remedy."""


class ConfigError(UserError):
    """A configuration file, flag or value that cannot be used."""


@contextlib.contextmanager
def writing(place: Path, *, what: str) -> Iterator[None]:
    """Raise a `ConfigError`, which begins with `what`, for a file that cannot be written.

    It names the file, or `place` if the system does not say which file it is.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(
            f"{what}: cannot write {error.filename or place}: {error.strerror or error}"
        ) from None


class ProfileError(UserError):
    """A delay profile that cannot be read."""


class LinkError(UserError):
    """An endpoint that cannot be opened, or at which no process answers."""


def one_of(words: Iterable[str], got: object, *, expected: str = "one of") -> str:
    """Return the text of an error about a word: the expected words, the one that came, and the
    word that was probably meant.
    """
    known = list(words)
    return f"expected {expected} {', '.join(known)}, got {got!r}{did_you_mean(known, got)}"


def did_you_mean(words: Iterable[str], got: object) -> str:
    """Return `; did you mean …?` with the known word most like `got`; empty if none is."""
    by_lower_case = {word.lower(): word for word in words}
    close = difflib.get_close_matches(str(got).lower(), by_lower_case, n=1)
    return f"; did you mean {by_lower_case[close[0]]}?" if close else ""


class MessageRefused(Exception):
    """A received message failed a check; `reason` is the name under which it is counted."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
