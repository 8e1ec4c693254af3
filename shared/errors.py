"""Every error that this project raises on purpose.

A user's mistake is a `UserError`. Entry points print it as one line, without a traceback, and exit
with code 2. A message that fails a check is a `MessageRefused`. It is counted under its reason and
dropped.
"""

from __future__ import annotations


class UserError(Exception):
    """A user's mistake. The message gives the expected value, the value that came, and a remedy."""


class ConfigError(UserError):
    """A configuration file, flag or value that cannot be used."""


class ProfileError(UserError):
    """A delay profile that cannot be read."""


class LinkError(UserError):
    """An endpoint that cannot be opened, or at which no process answers."""


class MessageRefused(Exception):
    """A received message failed a check; `reason` is the name under which it is counted."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
