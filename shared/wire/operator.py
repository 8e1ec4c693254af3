"""Commands of an operator to a running stack, and the events that they become.

A command is a line of text, in the command line, on the telemetry session and in a run's record
alike: `push 120N +y --for 0.2s`, `link delay 80ms`, `controller lc`. `parse_command` makes a value
of it and `str` the text again. A `CommandEvent` is a command with the task time of its effect. The
file `events.txt` of a run has one event a line, `2.500s link cut`, and a script has the same form.

Commands travel on the telemetry session, which never crosses the link under test.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgpack

from shared.config.extensions import CONTROLLERS
from shared.config.quantities import parse_angle, parse_duration_ns, parse_push
from shared.errors import ConfigError, MessageRefused, one_of
from shared.regular_file import read_regular

# Keys of the telemetry session: the three receivers of commands, the events, and the robot's clock.
ROBOT_COMMANDS_KEY = "command/robot"
LINK_COMMANDS_KEY = "command/link"
EDGE_COMMANDS_KEY = "command/edge"
EVENTS_KEY = "telemetry/events"
CLOCK_KEY = "telemetry/clock"
# The view publishes an empty message on this key once a person can see it.
VIEW_KEY = "telemetry/view"

EVENTS_FILE = "events.txt"
TICK_NS = 1_000_000
_VERSION = 1
_MAX_TEXT = 300
_MAX_BYTES = 1_000
_MAX_FILE_BYTES = 10_000_000
# Of bytes that another program may have sent.
_UNREADABLE = (msgpack.UnpackException, TypeError, ValueError, OverflowError)
# More is a typing error, or breaks the robot.
_MAX_FORCE, _MAX_PUSH_NS = 10_000.0, 60_000_000_000
_PUSH_FOR = "0.2s"
_MAX_STEP_TICKS = 60_000
_SLOWEST = 0.01
_MAX_DELAY_NS = 60_000_000_000
# Numbers are rounded to so many decimals, so that a text and its value say the same.
_DIGITS = 6
_FARTHEST, _FASTEST = 1000.0, 2.0
# A velocity holds for so long after its command [ns], by the robot's clock.
DRIVE_NS = 1_000_000_000


@dataclass(frozen=True)
class PushCommand:
    """A push on the base by `force` [N] along `direction`, as in `+y` or `+x-y`."""

    force: float
    direction: str
    duration_ns: int

    def __str__(self) -> str:
        lasts = _duration(self.duration_ns)
        return f"push {_number(self.force)}N {self.direction} --for {lasts}"

    @property
    def vector(self) -> tuple[float, float, float]:
        """The force in the world frame [N]."""
        return parse_push(f"{self.force:f}N@0s:0s:{self.direction}").force


@dataclass(frozen=True)
class SwitchController:
    """The robot uses another controller from its first usable answer on."""

    controller: str

    def __str__(self) -> str:
        return f"controller {self.controller}"


@dataclass(frozen=True)
class Reset:
    """The robot stands as at the beginning of its task. The time of the task goes on."""

    def __str__(self) -> str:
        return "reset"


@dataclass(frozen=True)
class Pause:
    """Simulated time stands still."""

    def __str__(self) -> str:
        return "pause"


@dataclass(frozen=True)
class Step:
    """Simulated time goes on for a number of ticks, and then stands still."""

    ticks: int

    def __str__(self) -> str:
        return f"step {self.ticks}"


@dataclass(frozen=True)
class Speed:
    """Simulated time runs at `factor` × real time, at most 1."""

    factor: float

    def __str__(self) -> str:
        return f"speed {_number(self.factor)}"


@dataclass(frozen=True)
class Resume:
    """Simulated time goes on after a pause, at its speed before."""

    def __str__(self) -> str:
        return "resume"


@dataclass(frozen=True)
class Cut:
    """The link loses every message from now on."""

    def __str__(self) -> str:
        return "link cut"


@dataclass(frozen=True)
class Restore:
    """The link has no cut, outage, added delay or changed loss any more. Its profile stays."""

    def __str__(self) -> str:
        return "link restore"


@dataclass(frozen=True)
class AddDelay:
    """The link adds this delay to the round trip, half of it each way; zero: none."""

    round_trip_ns: int

    def __str__(self) -> str:
        return f"link delay {_duration(self.round_trip_ns)}"


@dataclass(frozen=True)
class SetLoss:
    """The link loses a message with this probability, each way."""

    probability: float

    def __str__(self) -> str:
        return f"link loss {_number(100 * self.probability)}%"


@dataclass(frozen=True)
class ReplaceProfile:
    """The link replays another profile, by its name for `--network`."""

    network: str

    def __str__(self) -> str:
        return f"link profile {self.network}"


@dataclass(frozen=True)
class Stall:
    """The link passes no message for a time. A message sent meanwhile waits for its end."""

    duration_ns: int

    def __str__(self) -> str:
        return f"link outage {_duration(self.duration_ns)}"


@dataclass(frozen=True)
class Go:
    """The robot walks to a place in the plan's frame, (x, y) [m] and heading [rad], and stands."""

    x: float
    y: float
    yaw: float

    def __str__(self) -> str:
        return f"go {_number(self.x)} {_number(self.y)} {_number(self.yaw)}"


@dataclass(frozen=True)
class Drive:
    """The robot walks at a velocity: forward, to the left [m/s], turning to the left [rad/s].

    It comes to a stand unless the command comes again within `DRIVE_NS`.
    """

    forward: float
    left: float
    turning: float

    def __str__(self) -> str:
        numbers = (self.forward, self.left, self.turning)
        return f"drive {' '.join(map(_number, numbers))}"


# Carried out by the robot, the shim and the edge.
RobotCommand = PushCommand | SwitchController | Reset | Pause | Step | Speed | Resume
LinkCommand = Cut | Restore | AddDelay | SetLoss | ReplaceProfile | Stall
EdgeCommand = Go | Drive
Command = RobotCommand | LinkCommand | EdgeCommand


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
    force = round(float(number[1]), _DIGITS) if number is not None else math.inf
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
    factor = round(float(text), _DIGITS) if re.fullmatch(r"[0-9]*\.?[0-9]+", text) else math.nan
    if not _SLOWEST <= factor <= 1.0:
        raise _unexpected("speed", f"{_SLOWEST:g} to 1 × real time", words)
    return Speed(factor)


def _go(words: Sequence[str]) -> Command:
    try:
        x, y = (round(float(word), _DIGITS) for word in words[:2])
        yaw = round(parse_angle(words[2]), _DIGITS) if len(words) == 3 else math.nan
        if not max(abs(x), abs(y)) <= _FARTHEST or not abs(yaw) <= math.tau:
            raise ValueError
    except (ValueError, ConfigError):
        raise _unexpected("go", "X Y YAW in m and rad, as in 1.5 0 90deg", words) from None
    return Go(x, y, yaw)


def _drive(words: Sequence[str]) -> Command:
    try:
        forward, left, turning = (round(float(word), _DIGITS) for word in words)
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
    return SetLoss(round(loss, _DIGITS))


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
        least, most = _duration(at_least), _duration(at_most)
        raise ConfigError(f"{name}: expected {least} to {most}, got {text}")
    return duration_ns


def _number(value: float) -> str:
    """Return a number as the parsers read it, without a loss of digits."""
    return f"{value + 0.0:.{_DIGITS}f}".rstrip("0").rstrip(".")


def _duration(duration_ns: int) -> str:
    """Return a duration as `parse_duration_ns` reads it."""
    if duration_ns % 1_000_000_000 == 0 and duration_ns:
        return f"{duration_ns // 1_000_000_000}s"
    return f"{duration_ns * 1e-6:.9g}ms"


@dataclass(frozen=True)
class CommandEvent:
    """A command that takes effect with the tick of the task time `time_ns`, whole milliseconds."""

    time_ns: int
    command: Command

    def __str__(self) -> str:
        return f"{self.time_ns * 1e-9:.3f}s {self.command}"


def parse_event(text: str) -> CommandEvent:
    """`2.500s link cut` → the command, at that time of the task, rounded up to a tick."""
    at, _, command = text.strip().partition(" ")
    time_ns = parse_duration_ns(at)
    return CommandEvent(-(-time_ns // TICK_NS) * TICK_NS, parse_command(command))


def read_events(path: Path) -> tuple[CommandEvent, ...]:
    """Return the events of a file in the order of their times. Raise `ConfigError` with the line
    that cannot be used.

    Empty lines and lines that begin with # are left out.
    """
    try:
        text = read_regular(path, at_most=_MAX_FILE_BYTES).decode(errors="replace")
    except OSError as error:
        raise ConfigError(f"events: cannot read {path}: {error.strerror or error}") from None
    events = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            events.append(parse_event(line))
        except ConfigError as error:
            raise ConfigError(f"events: {path}, line {number}: {error}") from None
    return tuple(sorted(events, key=lambda event: event.time_ns))


def write_events(path: Path, events: Iterable[CommandEvent]) -> None:
    """Write events as `read_events` reads them. Raise `OSError` if the file cannot be written."""
    path.write_text("".join(f"{event}\n" for event in events), encoding="utf-8")


@dataclass(frozen=True)
class Accepted:
    """The answer to a command that is carried out.

    It takes effect with the tick of the task time `time_ns` [ns]. `note` says more in a line; it
    may be empty.
    """

    time_ns: int
    note: str = ""


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
        raise ConfigError("command: expected an answer of this version of the software") from None


def encode_event(event: CommandEvent, *, wall_ns: int) -> bytes:
    """Return the message of an event, for the telemetry session. `wall_ns` is as in the rows."""
    return bytes(msgpack.packb([event.time_ns, str(event.command), wall_ns]))


def decode_event(data: bytes) -> tuple[CommandEvent, int]:
    """Return an event and its time by the robot's clock [ns]; `MessageRefused` if it is none."""
    try:
        if len(data) > _MAX_BYTES:
            raise ValueError
        time_ns, text, wall_ns = msgpack.unpackb(data)
        return CommandEvent(int(time_ns), parse_command(str(text))), int(wall_ns)
    except (*_UNREADABLE, ConfigError):
        raise MessageRefused("event", "expected a command and its time") from None


def _unpacked(data: bytes, kind: type) -> tuple[object, str]:
    try:
        if len(data) > _MAX_BYTES:
            raise ValueError
        version, value = msgpack.unpackb(data)
        if not isinstance(value, kind):
            raise ValueError
    except _UNREADABLE:
        raise ConfigError("command: expected a message of this version of the software") from None
    return version, str(value)
