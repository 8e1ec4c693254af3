"""Make a request to a running stack over its control socket: see `control_server`.

It imports little, so that a command reaches a stack at once.
"""

from __future__ import annotations

import json
import socket
from typing import Any

from deploy.background.state import StackFolder, within
from shared.commands import wbc
from shared.errors import LinkError
from shared.wire.operator.commands import Accepted, Command

# Longer than the robot, the shim or the edge may take.
_ANSWER_SECONDS = 30.0


def request_restart(stack: StackFolder, service: str, *, within_seconds: float) -> None:
    """Ask a stack to start a service again; return when it is ready.

    Raise `LinkError` if it does not become ready.
    """
    _request(stack, "restart", service, within_seconds=within_seconds)


class StackClient:
    """Sends an operator's commands to a stack, which passes them on over its telemetry hub."""

    def __init__(self, stack: StackFolder) -> None:
        self._stack = stack

    def send(self, command: Command) -> Accepted:
        """Send a command and wait until it takes effect.

        Raise `LinkError` with the reason if it is refused, or if no process answers.
        """
        answer = _request(self._stack, "command", str(command), within_seconds=_ANSWER_SECONDS)
        return Accepted(int(answer["time_ns"]), str(answer["note"]))


def _request(stack: StackFolder, name: str, text: str, *, within_seconds: float) -> dict[str, Any]:
    asking = socket.socket(socket.AF_UNIX)
    asking.settimeout(within_seconds)
    try:
        with asking:
            with within(stack.folder):
                asking.connect(stack.control.name)
            asking.sendall(json.dumps({name: text}).encode() + b"\n")
            with asking.makefile(encoding="utf-8") as answers:
                answer: dict[str, Any] = json.loads(answers.readline())
    except (OSError, ValueError):
        raise LinkError(
            f"{name}: {stack.run} does not answer; {wbc('ps')} says whether it runs"
        ) from None
    if "error" in answer:
        raise LinkError(answer["error"])
    return answer
