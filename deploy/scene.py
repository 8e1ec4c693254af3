"""The scene of the demonstration, and the sender of typed commands."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from shared.bus.operator import CommandClient
from shared.errors import UserError
from shared.wire.operator.commands import Command
from shared.wire.operator.events import parse_event

# The events of `up` without arguments, beside the push of the settings: an outage, and a cut link.
DEMO = tuple(
    parse_event(text) for text in ("2.2s link outage 300ms", "3.2s link cut", "4.2s link restore")
)


class Sender:
    """Sends commands, one after another, without holding up the loop. Refusals are printed."""

    def __init__(self, client: CommandClient, say: Callable[[str], None]) -> None:
        self._client = client
        self._say = say
        self._lock = asyncio.Lock()

    async def send(self, command: Command) -> None:
        """Send a command and wait for its answer."""
        async with self._lock:
            try:
                await asyncio.to_thread(self._client.send, command)
            except UserError as error:
                self._say(str(error))
