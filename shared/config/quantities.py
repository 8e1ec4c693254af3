"""Values written with their units, as in flags and files: `30ms`, `15deg`, `100N@1.0s:0.2s:+y`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from shared.errors import ConfigError


@dataclass(frozen=True)
class Push:
    """A force on the base [N], world frame, from `start_ns` for `duration_ns`."""

    force: tuple[float, float, float]
    start_ns: int
    duration_ns: int

    def active(self, time_ns: int) -> bool:
        """Return whether the push acts at `time_ns` of the task."""
        return self.start_ns <= time_ns < self.start_ns + self.duration_ns

    def over(self, time_ns: int) -> bool:
        """Return whether the push has acted before `time_ns` of the task and never will again."""
        return self.start_ns + self.duration_ns <= time_ns


_UNITS_NS = {"us": 1e3, "ms": 1e6, "s": 1e9}
# Larger times and forces are typing errors. Up to this bound, times stay well inside 64 bits of ns.
_MAX_SECONDS = 1e6
_PUSH = re.compile(
    r"(?P<force>[0-9.]+)N@(?P<start>[0-9.]+)s:(?P<duration>[0-9.]+)s:(?P<direction>[+-][xyz]|[+-]x[+-]y)"
)


def parse_push(text: str) -> Push:
    """`100N@1.0s:0.2s:+y` → 100 N along +y of the world from 1.0 s for 0.2 s.

    `+x-y` is a direction too: the diagonal between +x and −y.
    """
    match = _PUSH.fullmatch(text.strip())
    try:
        if match is None:
            raise ValueError
        size, start = float(match["force"]), float(match["start"])
        duration = float(match["duration"])
        if not max(size, start, duration) <= _MAX_SECONDS:
            raise ValueError
    except ValueError:
        raise ConfigError(
            f"push: expected FORCE@START:DURATION:DIRECTION as in 100N@1.0s:0.2s:+y "
            f"(direction ±x, ±y, ±z or ±x±y), or none, got {text!r}"
        ) from None
    direction = match["direction"]
    signs, axes = direction[::2], direction[1::2]
    share = size / math.sqrt(len(axes))
    force = [0.0, 0.0, 0.0]
    for sign, axis in zip(signs, axes, strict=True):
        force["xyz".index(axis)] = share if sign == "+" else -share
    return Push((force[0], force[1], force[2]), round(start * 1e9), round(duration * 1e9))


@dataclass(frozen=True)
class Outage:
    """A span of the link's time in which no message passes; `duration_ns` None: it never ends."""

    start_ns: int
    duration_ns: int | None

    def begun(self, time_ns: int) -> bool:
        """Return whether the outage acts on a message sent at `time_ns`."""
        end_ns = math.inf if self.duration_ns is None else self.start_ns + self.duration_ns
        return self.start_ns <= time_ns < end_ns

    def over(self, time_ns: int) -> bool:
        """Return whether the outage has ended by `time_ns`."""
        return self.duration_ns is not None and self.start_ns + self.duration_ns <= time_ns


def parse_outage(text: str) -> Outage:
    """`389ms@1.2s` → an outage of 389 ms from 1.2 s on; `cut@4s` → from 4 s on, for ever."""
    duration, _, start = text.strip().partition("@")
    try:
        return Outage(
            parse_duration_ns(start), None if duration == "cut" else parse_duration_ns(duration)
        )
    except ConfigError:
        raise ConfigError(
            f"outage: expected DURATION@START as in 389ms@1.2s, or cut@4s, got {text!r}"
        ) from None


def parse_duration_ns(text: str) -> int:
    """`30ms`, `1.5s` or `800us` → nanoseconds."""
    match = re.fullmatch(r"([0-9]*\.?[0-9]+)(us|ms|s)", text.strip())
    nanoseconds = float("inf") if match is None else float(match[1]) * _UNITS_NS[match[2]]
    if not nanoseconds <= _MAX_SECONDS * 1e9:
        raise ConfigError(f"expected a duration as in 30ms, 1.5s or 800us, got {text!r}")
    return round(nanoseconds)


def parse_seconds(text: str) -> float:
    """`5s`, `800ms` or `5` → seconds."""
    try:
        return float(text)
    except ValueError:
        return parse_duration_ns(text) * 1e-9


def parse_angle(text: str) -> float:
    """`15deg`, `-0.26rad` or `0.26` → radians."""
    match = re.fullmatch(r"([+-]?[0-9]*\.?[0-9]+)(deg|rad)?", text.strip())
    if match is None:
        raise ConfigError(f"expected an angle as in 15deg or 0.26rad, got {text!r}")
    return math.radians(float(match[1])) if match[2] == "deg" else float(match[1])


_UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, None: 1.0}
_LENGTH = re.compile(r"([+-]?[0-9]*\.?[0-9]+)(mm|cm|m)?")


def parse_length(text: str) -> float:
    """`6cm`, `-20mm`, `1.5m` or `1.5` → metres."""
    match = _LENGTH.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"expected a length as in 6cm, 1.5m or 1.5, got {text!r}")
    # To the micrometre: 6 × 0.01 is not 0.06.
    return round(float(match[1]) * _UNITS_M[match[2]], 6)


@dataclass(frozen=True)
class Goal:
    """A place to stand: the middle between the feet (x, y) [m], and the heading [rad]."""

    x: float
    y: float
    yaw: float


# A walk of more metres than this has more steps than a plan may have.
_FARTHEST = 50.0


def parse_goal(text: str) -> Goal:
    """`2,0.5,90deg` → 2 m forward, 0.5 m to the left, turned by 90° to the left.

    `2` and `2,0.5` leave out a zero.
    """
    parts = text.split(",")
    try:
        if len(parts) > 3:
            raise ConfigError("too many")
        x, y = (parse_length(part) for part in (*parts[:2], "0")[:2])
        yaw = parse_angle(parts[2]) if len(parts) == 3 else 0.0
        if not (math.hypot(x, y) <= _FARTHEST and abs(yaw) <= math.tau):
            raise ConfigError("too far")
    except ConfigError:
        raise ConfigError(
            "goal: expected X,Y,HEADING as in 2,0.5,90deg, at most "
            f"{_FARTHEST:g} m away and one turn, got {text!r}"
        ) from None
    return Goal(x, y, yaw)


@dataclass(frozen=True)
class GroundSpec:
    """The description of a ground: its `kind`, and the kind's numbers in SI units or its `file`."""

    kind: str
    count: int = 0
    size: float = 0.0
    file: str = ""


# The largest number of each kind: heights and widths [m], a slope [rad].
_MAX_SIZE = {"blocks": 0.1, "stairs": 0.2, "gap": 0.5, "slope": math.radians(20.0)}
_MAX_STAIRS = 20


def parse_ground(text: str) -> GroundSpec:
    """`flat`, `blocks:2cm`, `stairs:3x6cm`, `gap:10cm`, `slope:8deg` or `FILE.npz`."""
    if text == "flat":
        return GroundSpec("flat")
    if text.endswith(".npz"):
        return GroundSpec("file", file=text)
    kind, _, numbers = text.partition(":")
    try:
        count, by, length = numbers.rpartition("x")
        stairs = int(count) if kind == "stairs" else 0
        size = parse_angle(length) if kind == "slope" else parse_length(length)
        if kind not in _MAX_SIZE or (by != "") is not (kind == "stairs") or stairs > _MAX_STAIRS:
            raise ValueError
        if not 0.0 < abs(size) <= _MAX_SIZE[kind] + 1e-9 or (kind == "stairs" and stairs < 1):
            raise ValueError
        if size < 0.0 and kind in ("blocks", "gap"):
            raise ValueError
    except (ValueError, ConfigError):
        bounds = (
            f"blocks to {_MAX_SIZE['blocks']:g} m, {_MAX_STAIRS} stairs of {_MAX_SIZE['stairs']:g} "
            f"m, a gap of {_MAX_SIZE['gap']:g} m, 20°"
        )
        raise ConfigError(
            "ground: expected flat, blocks:2cm, stairs:3x6cm, gap:10cm, slope:8deg or FILE.npz "
            f"(at most {bounds}), got {text!r}"
        ) from None
    return GroundSpec(kind, stairs, size)
