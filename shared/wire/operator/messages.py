"""The messages of commands, answers and events, and their keys on the telemetry session."""

from __future__ import annotations

import msgpack

from shared.errors import ConfigError, MessageRefused
from shared.wire.operator.commands import Accepted, Command
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.texts import parse_command

# The three receivers of commands, the events, and the robot's clock.
ROBOT_COMMANDS_KEY = "command/robot"
LINK_COMMANDS_KEY = "command/link"
EDGE_COMMANDS_KEY = "command/edge"
EVENTS_KEY = "telemetry/events"
CLOCK_KEY = "telemetry/clock"
# The view publishes an empty message on this key once a person can see it.
VIEW_KEY = "telemetry/view"

_VERSION = 1
_MAX_BYTES = 1_000
# The errors that bytes of another program may raise.
_UNREADABLE = (msgpack.UnpackException, TypeError, ValueError, OverflowError)


def encode_command(command: Command) -> bytes:
    """Return the message of a command."""
    return bytes(msgpack.packb([_VERSION, str(command)]))


def decode_command(data: bytes) -> Command:
    """Return the command of a message; raise `ConfigError` if it cannot be used."""
    version, text = _unpacked(data, str)
    if version != _VERSION:
        raise ConfigError(f"command: expected version {_VERSION} of the messages, got {version}")
    return parse_command(text)


def encode_answer(answer: Accepted | str) -> bytes:
    """Return the message of an answer; a text is the reason of a refusal."""
    if isinstance(answer, str):
        return bytes(msgpack.packb(["refused", answer]))
    return bytes(msgpack.packb(["accepted", [answer.time_ns, answer.note]]))


def decode_answer(data: bytes) -> Accepted | str:
    """Return an answer; a text is the reason of a refusal. Raise `ConfigError` if it is none."""
    try:
        kind, value = msgpack.unpackb(data)
        if kind == "refused":
            return str(value)
        time_ns, note = value
        return Accepted(int(time_ns), str(note))
    except _UNREADABLE:
        raise ConfigError("command: expected an answer of this version, got another one") from None


def encode_event(event: CommandEvent, *, wall_ns: int) -> bytes:
    """Return the message of an event, for the telemetry session. `wall_ns` is as in the telemetry
    rows.
    """
    return bytes(msgpack.packb([event.time_ns, str(event.command), wall_ns]))


def decode_event(data: bytes) -> tuple[CommandEvent, int]:
    """Return an event and its time by the robot's clock [ns]; `MessageRefused` if it is none."""
    try:
        if len(data) > _MAX_BYTES:
            raise ValueError
        time_ns, text, wall_ns = msgpack.unpackb(data)
        return CommandEvent(int(time_ns), parse_command(str(text))), int(wall_ns)
    except (*_UNREADABLE, ConfigError):
        raise MessageRefused(
            "event", "expected a command and its time, got another value"
        ) from None


def _unpacked(data: bytes, kind: type) -> tuple[object, str]:
    try:
        if len(data) > _MAX_BYTES:
            raise ValueError
        version, value = msgpack.unpackb(data)
        if not isinstance(value, kind):
            raise ValueError
    except _UNREADABLE:
        raise ConfigError("command: expected a message of this version, got another one") from None
    return version, str(value)
