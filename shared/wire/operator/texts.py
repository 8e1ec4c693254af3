"""The texts of an operator's commands: each word with its own parser."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

from shared.config.quantities import parse_angle, parse_duration_ns
from shared.errors import ConfigError, one_of
from shared.wire.operator.commands import (
    DIGITS,
    TICK_NS,
    AddDelay,
    Command,
    Cut,
    Drive,
    Go,
    Pause,
    PushCommand,
    ReplaceProfile,
    Reset,
    Restore,
    Resume,
    SetLoss,
    Speed,
    Stall,
    Step,
    SwitchController,
    duration_text,
)

_MAX_TEXT = 300
# A larger force is a typing error, or breaks the robot.
_MAX_FORCE, _MAX_PUSH_NS = 10_000.0, 60_000_000_000
_PUSH_FOR = "0.2s"
_MAX_STEP_TICKS = 60_000
_SLOWEST = 0.01
_MAX_DELAY_NS = 60_000_000_000
_FARTHEST, _FASTEST = 1000.0, 2.0


def parse_command(text: str) -> Command:
    """Return the command of a text; raise `ConfigError` if it is none."""
    if len(text) > _MAX_TEXT:
        raise ConfigError(f"command: expected at most {_MAX_TEXT} characters, got {len(text)}")
    name, *words = text.split() or [""]
    parse = _PARSERS.get(name)
    if parse is None:
        raise ConfigError(f"command: {one_of(_PARSERS, name)}")
    return parse(words)


def _push(words: Sequence[str]) -> Command:
    if len(words) == 2:
        words = [*words, "--for", _PUSH_FOR]
    if len(words) != 4 or words[2] != "--for":
        raise _unexpected("push", "FORCE DIRECTION as in 120N +y, and --for 0.2s", words)
    size, direction, lasts = words[0], words[1], words[3]
    number = re.fullmatch(r"([0-9]*\.?[0-9]+)N", size)
    force = round(float(number[1]), DIGITS) if number is not None else math.inf
    if not 0.0 < force <= _MAX_FORCE:
        raise ConfigError(f"push: expected a force up to {_MAX_FORCE:g}N as in 120N, got {size!r}")
    duration_ns = _duration_of("push", lasts, at_least=TICK_NS, at_most=_MAX_PUSH_NS)
    command = PushCommand(force, direction, duration_ns)
    try:
        _ = command.vector
    except ConfigError:
        raise ConfigError(
            f"push: expected a direction ±x, ±y, ±z or ±x±y, got {direction!r}"
        ) from None
    return command


def _controller(words: Sequence[str]) -> Command:
    # Imported here: the tables of names take longer to load than all commands.
    from shared.config.extensions import CONTROLLERS

    if len(words) != 1:
        raise _unexpected("controller", f"one of {', '.join(CONTROLLERS.own)}", words)
    name = words[0].lower() if words[0].lower() in CONTROLLERS.own else words[0]
    try:
        CONTROLLERS.check(name)
    except ConfigError as error:
        raise ConfigError(f"controller: {error}") from None
    return SwitchController(name)


def _step(words: Sequence[str]) -> Command:
    text = words[0] if words else "1"
    ticks = int(text) if re.fullmatch(r"[0-9]{1,9}", text) else 0
    if not ticks and not text.isdecimal():
        ticks = _duration_of("step", text, at_least=0, at_most=10**12) // TICK_NS
    if len(words) > 1 or not 1 <= ticks <= _MAX_STEP_TICKS:
        raise _unexpected("step", f"1 to {_MAX_STEP_TICKS} ticks of 1 ms, or a time 20ms", words)
    return Step(ticks)


def _speed(words: Sequence[str]) -> Command:
    text = words[0] if len(words) == 1 else ""
    factor = round(float(text), DIGITS) if re.fullmatch(r"[0-9]*\.?[0-9]+", text) else math.nan
    if not _SLOWEST <= factor <= 1.0:
        raise _unexpected("speed", f"{_SLOWEST:g} to 1 × real time", words)
    return Speed(factor)


def _go(words: Sequence[str]) -> Command:
    try:
        x, y = (round(float(word), DIGITS) for word in words[:2])
        yaw = round(parse_angle(words[2]), DIGITS) if len(words) == 3 else math.nan
        if not max(abs(x), abs(y)) <= _FARTHEST or not abs(yaw) <= math.tau:
            raise ValueError
    except (ValueError, ConfigError):
        raise _unexpected("go", "X Y YAW in m and rad, as in 1.5 0 90deg", words) from None
    return Go(x, y, yaw)


def _drive(words: Sequence[str]) -> Command:
    try:
        forward, left, turning = (round(float(word), DIGITS) for word in words)
        if not max(abs(forward), abs(left), abs(turning)) <= _FASTEST:
            raise ValueError
    except ValueError:
        raise _unexpected(
            "drive", f"FORWARD LEFT TURNING up to {_FASTEST:g} m/s and rad/s, as in 0.2 0 0", words
        ) from None
    return Drive(forward, left, turning)


def _without_words(name: str, make: Callable[[], Command]) -> Callable[[Sequence[str]], Command]:
    def parse(words: Sequence[str]) -> Command:
        if words:
            raise _unexpected(name, "no more words", words)
        return make()

    return parse


def _link(words: Sequence[str]) -> Command:
    name = words[0] if words else ""
    parse = _LINK_PARSERS.get(name)
    if parse is None:
        raise ConfigError(f"link: {one_of(LINK_WORDS, name)}")
    return parse(words[1:])


def _delay(words: Sequence[str]) -> Command:
    text = _only("link delay", "a round trip to add, as in 80ms", words)
    return AddDelay(_duration_of("link delay", text, at_least=0, at_most=_MAX_DELAY_NS))


def _loss(words: Sequence[str]) -> Command:
    text = _only("link loss", "a probability as in 10% or 0.1", words)
    number = re.fullmatch(r"([0-9]*\.?[0-9]+)(%?)", text)
    loss = math.nan if number is None else float(number[1]) / (100.0 if number[2] else 1.0)
    if not 0.0 <= loss < 1.0:
        raise _unexpected("link loss", "0% to less than 100%, as in 10% or 0.1", words)
    return SetLoss(round(loss, DIGITS))


def _profile(words: Sequence[str]) -> Command:
    network = _only("link profile", "a network as in factory/011 or constant:30ms", words)
    if network == "direct":
        raise _unexpected("link profile", "a network for the shim; try constant:0ms", words)
    return ReplaceProfile(network)


def _outage(words: Sequence[str]) -> Command:
    text = _only("link outage", "a duration as in 300ms", words)
    return Stall(_duration_of("link outage", text, at_least=TICK_NS, at_most=_MAX_DELAY_NS))


_LINK_PARSERS: dict[str, Callable[[Sequence[str]], Command]] = {
    "cut": _without_words("link cut", Cut),
    "restore": _without_words("link restore", Restore),
    "delay": _delay,
    "loss": _loss,
    "profile": _profile,
    "outage": _outage,
}
# The words after `link` that make it a command.
LINK_WORDS = tuple(_LINK_PARSERS)
_PARSERS: dict[str, Callable[[Sequence[str]], Command]] = {
    "push": _push,
    "link": _link,
    "controller": _controller,
    "go": _go,
    "drive": _drive,
    "pause": _without_words("pause", Pause),
    "step": _step,
    "speed": _speed,
    "resume": _without_words("resume", Resume),
    "reset": _without_words("reset", Reset),
}


def _only(name: str, expected: str, words: Sequence[str]) -> str:
    if len(words) != 1:
        raise _unexpected(name, expected, words)
    return words[0]


def _unexpected(name: str, expected: str, words: Sequence[str]) -> ConfigError:
    return ConfigError(f"{name}: expected {expected}, got {' '.join(words) or 'nothing'}")


def _duration_of(name: str, text: str, *, at_least: int, at_most: int) -> int:
    try:
        duration_ns = parse_duration_ns(text)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None
    if not at_least <= duration_ns <= at_most:
        least, most = duration_text(at_least), duration_text(at_most)
        raise ConfigError(f"{name}: expected {least} to {most}, got {text}")
    return duration_ns
