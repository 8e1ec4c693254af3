"""Every error this project raises on purpose.

A user's mistake is a `UserError`: entry points print it as one line and exit 2, no traceback.
A message that fails a check is a `MessageRefused`: it is counted under its reason and dropped.
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
    """A received message failed a check; `reason` is the name it is counted under."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
