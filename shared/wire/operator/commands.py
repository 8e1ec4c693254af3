"""The commands of an operator as values. `str` gives the text of a command."""

from __future__ import annotations

from dataclasses import dataclass

from shared.config.quantities import parse_push

TICK_NS = 1_000_000
# A velocity holds for this time after its command [ns], by the robot's clock.
DRIVE_NS = 1_000_000_000
# Numbers are rounded to this number of decimals, so that a text and its value say the same.
DIGITS = 6


@dataclass(frozen=True)
class PushCommand:
    """A push on the base by `force` [N] along `direction`, as in `+y` or `+x-y`."""

    force: float
    direction: str
    duration_ns: int

    def __str__(self) -> str:
        lasts = duration_text(self.duration_ns)
        return f"push {number_text(self.force)}N {self.direction} --for {lasts}"

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
        return f"speed {number_text(self.factor)}"


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
        return f"link delay {duration_text(self.round_trip_ns)}"


@dataclass(frozen=True)
class SetLoss:
    """The link loses a message with this probability, each way."""

    probability: float

    def __str__(self) -> str:
        return f"link loss {number_text(100 * self.probability)}%"


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
        return f"link outage {duration_text(self.duration_ns)}"


@dataclass(frozen=True)
class Go:
    """The robot walks to a place in the plan's frame, (x, y) [m] and heading [rad], and stands."""

    x: float
    y: float
    yaw: float

    def __str__(self) -> str:
        return f"go {number_text(self.x)} {number_text(self.y)} {number_text(self.yaw)}"


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
        return f"drive {' '.join(map(number_text, numbers))}"


# Carried out by the robot, the shim and the edge.
RobotCommand = PushCommand | SwitchController | Reset | Pause | Step | Speed | Resume
LinkCommand = Cut | Restore | AddDelay | SetLoss | ReplaceProfile | Stall
EdgeCommand = Go | Drive
Command = RobotCommand | LinkCommand | EdgeCommand


@dataclass(frozen=True)
class Accepted:
    """The answer to a command that is carried out.

    It takes effect with the tick of the task time `time_ns` [ns]. `note` says more in a line; it
    may be empty.
    """

    time_ns: int
    note: str = ""


def number_text(value: float) -> str:
    """Return a number as the parsers read it, without a loss of digits."""
    return f"{value + 0.0:.{DIGITS}f}".rstrip("0").rstrip(".")


def duration_text(duration_ns: int) -> str:
    """Return a duration as `parse_duration_ns` reads it."""
    if duration_ns % 1_000_000_000 == 0 and duration_ns:
        return f"{duration_ns // 1_000_000_000}s"
    return f"{duration_ns * 1e-6:.9g}ms"
