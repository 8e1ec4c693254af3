"""Both ends of an operator's commands on the telemetry session: the client and the servers.

The robot and the shim each serve the commands that they carry out. A command has one answer. A
server takes at most about fifty commands a second, off the robot's tick; of a flood it takes some
and drops the others.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from shared.bus.zenoh_bus import ZenohBus
from shared.errors import LinkError, UserError
from shared.wire.operator import (
    LINK_COMMANDS_KEY,
    ROBOT_COMMANDS_KEY,
    Accepted,
    Command,
    LinkCommand,
    decode_answer,
    decode_command,
    encode_answer,
    encode_command,
)

_PAUSE_SECONDS = 0.02
_ANSWER_SECONDS = 5.0


class CommandClient:
    """Sends commands to the stack of a telemetry hub, over a session that `bus` has with it."""

    def __init__(self, bus: ZenohBus) -> None:
        self._bus = bus

    def send(self, command: Command) -> Accepted:
        """Send a command and wait until it takes effect.

        Raise `LinkError` with the reason if it is refused, or if no process answers.
        """
        of_link = isinstance(command, LinkCommand)
        key = LINK_COMMANDS_KEY if of_link else ROBOT_COMMANDS_KEY
        data = self._bus.ask(key, encode_command(command), within=_ANSWER_SECONDS)
        if data is None:
            who = "shim, which --network direct leaves out" if of_link else "robot"
            raise LinkError(
                f"{command}: expected an answer, got none: the stack has no {who}, or it gets too "
                "many commands at once; try again"
            )
        answer = decode_answer(data)
        if isinstance(answer, str):
            raise LinkError(answer)
        return answer


class CommandServer:
    """Answers the commands on a key, one after another, on a thread.

    `carry_out(command)` returns when the command has taken effect. It raises `UserError` for a
    command that it refuses.
    """

    def __init__(self, bus: ZenohBus, key: str, carry_out: Callable[[Command], Accepted]) -> None:
        self._requests = bus.serve(key)
        self._carry_out = carry_out
        threading.Thread(target=self._serve, name="commands", daemon=True).start()

    def _serve(self) -> None:
        while self._requests.answer(self._answer):
            time.sleep(_PAUSE_SECONDS)

    def _answer(self, data: bytes) -> bytes:
        try:
            return encode_answer(self._carry_out(decode_command(data)))
        except UserError as error:
            return encode_answer(str(error))
        except Exception as error:  # no command may end the thread
            return encode_answer(f"an unexpected error: {type(error).__name__}: {error}")
