"""Drive a robot by keys or by a gamepad, with a dead man's switch.

A key drives while it is held; without one for `_LET_GO_SECONDS` the robot comes to a stand. A
gamepad drives by its sticks while one of its shoulder buttons is held. If this program ends, or its
commands do not come through, the edge lets the robot stand a second later.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from deploy.background.control_client import StackClient
from deploy.console.keys import each_key, has_keys, typed_keys
from shared.errors import ConfigError
from shared.wire.operator.commands import Drive

GAMEPAD = Path("/dev/input/js0")
# The velocities of held keys [m/s, m/s, rad/s], which steps can follow.
KEYS = {
    "w": Drive(0.15, 0.0, 0.0),
    "s": Drive(-0.1, 0.0, 0.0),
    "a": Drive(0.0, 0.06, 0.0),
    "d": Drive(0.0, -0.06, 0.0),
    "q": Drive(0.0, 0.0, 0.25),
    "e": Drive(0.0, 0.0, -0.25),
}
_STOP = Drive(0.0, 0.0, 0.0)
_HELP = "w s forward, back · a d left, right · q e turn · any other key stops · Ctrl-C ends"
# Longer than the pause before a held key repeats.
_LET_GO_SECONDS = 0.7
# The time between two commands while nothing changes, and between two looks at the input.
_AGAIN_SECONDS, _LOOK_SECONDS = 0.3, 0.05
# An event of a joystick: time [ms], value, type, number.
_EVENT = struct.Struct("IhBB")
_BUTTON, _AXIS, _INITIAL = 1, 2, 0x80
_LEFT_X, _LEFT_Y, _RIGHT_X = 0, 1, 3
_SHOULDERS = (4, 5)
_FULL, _DEAD_ZONE = 32767.0, 0.15


class Gamepad:
    """The sticks and buttons of a gamepad, from its events."""

    def __init__(self) -> None:
        self._axes: dict[int, float] = {}
        self._pressed: set[int] = set()

    def take(self, data: bytes) -> None:
        """Take in events as the system gives them."""
        for _, value, kind, number in _EVENT.iter_unpack(data[: len(data) // 8 * 8]):
            kind &= ~_INITIAL
            if kind == _AXIS:
                part = value / _FULL
                self._axes[number] = part if abs(part) > _DEAD_ZONE else 0.0
            elif kind == _BUTTON:
                (self._pressed.add if value else self._pressed.discard)(number)

    @property
    def wanted(self) -> Drive | None:
        """The velocity that the sticks ask for; None unless a shoulder button is held."""
        if self._pressed.isdisjoint(_SHOULDERS):
            return None
        forward, left, turning = (
            -self._axes.get(axis, 0.0) for axis in (_LEFT_Y, _LEFT_X, _RIGHT_X)
        )
        return Drive(round(0.15 * forward, 3), round(0.06 * left, 3), round(0.25 * turning, 3))


class Hand:
    """The velocity that the keys ask for: that of the last key, until it is let go."""

    def __init__(self) -> None:
        self._wanted = _STOP
        self._typed_at = -1e9

    def take(self, typed: str, now: float) -> None:
        """Take in keys typed by `now` [s]; any other key stops."""
        if typed:
            self._wanted, self._typed_at = KEYS.get(typed[-1].lower(), _STOP), now

    def wanted(self, now: float) -> Drive:
        """Return the velocity that the keys ask for at the time `now` [s]."""
        return self._wanted if now - self._typed_at < _LET_GO_SECONDS else _STOP


def drive(client: StackClient) -> None:
    """Drive until Ctrl-C, and then let the robot stand."""
    if not has_keys():
        raise ConfigError("drive: expected a terminal for its keys, got none; try drive 0.2 0 0")
    hand, gamepad = Hand(), Gamepad()
    sent, sent_at = _STOP, -1e9
    with each_key(), _opened_gamepad() as joystick:
        print(_HELP, f"; {GAMEPAD}: hold a shoulder button" if joystick is not None else "", sep="")
        try:
            while True:
                files = [sys.stdin.fileno(), *([] if joystick is None else [joystick])]
                ready, _, _ = select.select(files, [], [], _LOOK_SECONDS)
                now = time.monotonic()
                if sys.stdin.fileno() in ready:
                    hand.take(typed_keys(), now)
                if joystick is not None and joystick in ready:
                    with contextlib.suppress(OSError):
                        gamepad.take(os.read(joystick, 64 * _EVENT.size))
                wanted = gamepad.wanted or hand.wanted(now)
                again = wanted != _STOP and now - sent_at > _AGAIN_SECONDS
                if wanted != sent or again:
                    client.send(wanted)
                    sent, sent_at = wanted, now
        finally:
            if sent != _STOP:
                client.send(_STOP)


@contextlib.contextmanager
def _opened_gamepad() -> Iterator[int | None]:
    """Yield a descriptor of the gamepad; None if there is none."""
    try:
        file = os.open(GAMEPAD, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        yield None
        return
    try:
        yield file
    finally:
        os.close(file)
