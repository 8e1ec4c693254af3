"""Every setting of the project as frozen dataclasses, read from TOML.

Sections of a file are the fields below. An unknown key, a value of the wrong type or out of range
is a `ConfigError` that names what is valid. Both ends of a link must agree on `task`, `robot` and
`wbc`; their digest travels in every message.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
import sys
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from shared.errors import ConfigError

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

TASKS = ("balance", "walk")
CONTROLLERS = ("la", "pr")
VIEWS = ("auto", "native", "web", "off")


@dataclass(frozen=True)
class Gains:
    """Feedback gains: kp [1/s²], kd = 2 √kp; the contact rows have damping only [1/s]."""

    com: float = 10.0
    base_orientation: float = 20.0
    posture: float = 10.0
    contact_damping: float = 20.0
    swing_foot: float = 300.0


@dataclass(frozen=True)
class Weights:
    """Task weights ω of Eq. (2a)."""

    com: float = 1.0
    base_orientation: float = 0.1
    posture: float = 1e-2
    force: float = 1e-5
    swing_foot: float = 10.0


@dataclass(frozen=True)
class WbcConfig:
    """The whole-body QP. `friction` is the controller's μ; `min_normal_force` per point [N]."""

    gains: Gains = field(default_factory=Gains)
    weights: Weights = field(default_factory=Weights)
    friction: float = 0.5
    min_normal_force: float = 1.0
    solver: str = "daqp"


@dataclass(frozen=True)
class RobotConfig:
    """The robot. `torque_clamp` is the multiple of the URDF's effort that actuators may give."""

    name: str = "romeo"
    torque_clamp: float = 1.45


@dataclass(frozen=True)
class PlantConfig:
    """Contact of the simulated plant: friction, and MuJoCo's (time constant [s], damping ratio)."""

    friction: float = 0.8
    contact_time_constant: float = 0.005
    contact_damping_ratio: float = 1.0


@dataclass(frozen=True)
class SensorConfig:
    """Standard deviation of Gaussian noise on joint positions [rad] and velocities [rad/s]."""

    joint_position_noise: float = 1e-2
    joint_velocity_noise: float = 0.0


@dataclass(frozen=True)
class LoopConfig:
    """The 1 kHz tick. `fresh_within_ns` is d* of Eq. (7).

    `hold_after` is the projector age [s] beyond which the robot holds its joints instead of using
    the cache: more than the outages of the factory and building profiles, less than LA lasts.
    `edge_compute_ns` is the edge's compute time under lockstep, where it is not measured.
    `connect_timeout` [s] is how long the robot waits for its first projector.
    """

    period_ns: int = 1_000_000
    fresh_within_ns: int = 500_000
    hold_after: float = 0.5
    edge_compute_ns: int = 300_000
    connect_timeout: float = 20.0


@dataclass(frozen=True)
class LinkConfig:
    """The emulated link. `network` is a profile name, a file, `constant:30ms` or `direct`.

    `loss` is an independent loss probability per message, each way. `keep_order` holds a message
    back until those sent before it have left, as a radio link layer does.
    """

    network: str = "factory/001"
    loss: float = 0.0
    keep_order: bool = True


@dataclass(frozen=True)
class WireConfig:
    """`projector_dtype` is `float64` or `float32`."""

    projector_dtype: str = "float64"


@dataclass(frozen=True)
class WalkConfig:
    """A walk: steps of (length, sideways) [m] and turn [rad] each, negative for the other way.

    `step_width` [m] is the distance of the soles side by side, 0 for that of standing. A step takes
    `step_duration` [s], of which `double_support` on both feet; the paper has 5 ms. The walk begins
    and ends on both feet for `begin_duration` and `end_duration` [s].
    """

    steps: int = 6
    step_length: float = 0.1
    step_sideways: float = 0.0
    step_turn: float = 0.0
    step_width: float = 0.0
    step_duration: float = 0.8
    double_support: float = 0.02
    swing_height: float = 0.05
    begin_duration: float = 1.0
    end_duration: float = 2.0

    @property
    def duration(self) -> float:
        """From standing to standing [s]."""
        return self.begin_duration + self.steps * self.step_duration + self.end_duration


@dataclass(frozen=True)
class SwitchConfig:
    """Contact switches, Sec. III-C; each part can be turned off.

    `prepare_on_edge`, `prepare_on_board`: the solution of the next contact mode is computed from a
    state `prepare_ns` before the switch, by the edge for the states it gets and once on the robot.
    `solve_on_board`: in a window of `window_ns` centred on the switch the robot solves the full QP
    itself every `period_ns`. A solution on board is ready `compute_ns` after its state, which
    stands for a slow computer: the paper's takes at most 2.4 ms at 1.2 GHz. A preparation that
    takes longer than `prepare_ns` begins earlier, to be ready in time.
    """

    prepare_on_edge: bool = True
    prepare_on_board: bool = True
    solve_on_board: bool = True
    prepare_ns: int = 10_000_000
    window_ns: int = 100_000_000
    period_ns: int = 5_000_000
    compute_ns: int = 2_400_000


@dataclass(frozen=True)
class RunConfig:
    """One run, complete: the same file and seed give the same run."""

    task: str = "balance"
    controller: str = "la"
    duration: float = 5.0
    seed: int = 0
    push: tuple[str, ...] = ("100N@1.0s:0.2s:+y",)
    view: str = "auto"
    robot: RobotConfig = field(default_factory=RobotConfig)
    wbc: WbcConfig = field(default_factory=WbcConfig)
    walk: WalkConfig = field(default_factory=WalkConfig)
    switch: SwitchConfig = field(default_factory=SwitchConfig)
    plant: PlantConfig = field(default_factory=PlantConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    link: LinkConfig = field(default_factory=LinkConfig)
    wire: WireConfig = field(default_factory=WireConfig)

    def __post_init__(self) -> None:
        _one_of("task", self.task, TASKS)
        _one_of("controller", self.controller, CONTROLLERS)
        _one_of("view", self.view, VIEWS)
        _one_of("wire.projector_dtype", self.wire.projector_dtype, ("float32", "float64"))
        gains, weights = self.wbc.gains, self.wbc.weights
        for name, value, low in (
            ("duration", self.duration, 1e-3),
            *((f"wbc.gains.{key}", gain, 0.0) for key, gain in vars(gains).items()),
            *((f"wbc.weights.{key}", weight, 1e-9) for key, weight in vars(weights).items()),
            ("seed", self.seed, 0),
            ("robot.torque_clamp", self.robot.torque_clamp, 0.01),
            ("sensors.joint_position_noise", self.sensors.joint_position_noise, 0.0),
            ("sensors.joint_velocity_noise", self.sensors.joint_velocity_noise, 0.0),
            ("wbc.friction", self.wbc.friction, 1e-3),
            ("wbc.min_normal_force", self.wbc.min_normal_force, 0.0),
            ("walk.step_width", self.walk.step_width, 0.0),
            ("walk.double_support", self.walk.double_support, 1e-3),
            ("walk.step_duration", self.walk.step_duration, 0.2),
            ("walk.swing_height", self.walk.swing_height, 0.0),
            ("walk.begin_duration", self.walk.begin_duration, 0.5),
            ("walk.end_duration", self.walk.end_duration, 0.5),
            ("switch.prepare_ns", self.switch.prepare_ns, 0),
            ("switch.window_ns", self.switch.window_ns, 0),
            ("switch.period_ns", self.switch.period_ns, 1_000_000),
            ("switch.compute_ns", self.switch.compute_ns, 0),
            ("plant.friction", self.plant.friction, 1e-3),
            ("loop.connect_timeout", self.loop.connect_timeout, 0.0),
            ("loop.hold_after", self.loop.hold_after, 0.0),
            ("loop.edge_compute_ns", self.loop.edge_compute_ns, 0),
            ("link.loss", self.link.loss, 0.0),
        ):
            # Only the age limit may be infinite, which means never.
            if not (value >= low and (math.isfinite(value) or name == "loop.hold_after")):
                raise ConfigError(f"{name}: expected a number ≥ {low:g}, got {value!r}")
        if not self.link.loss < 1.0:
            raise ConfigError(f"link.loss: expected a probability below 1, got {self.link.loss}")
        if not self.duration < 1e6:
            raise ConfigError(f"duration: expected less than 1e6 s, got {self.duration}")
        if self.loop.period_ns != 1_000_000:
            raise ConfigError("loop.period_ns: only 1000000 (1 kHz) is supported")
        if not 0 < self.loop.fresh_within_ns < self.loop.period_ns:
            raise ConfigError(
                "loop.fresh_within_ns: expected a deadline inside the period, "
                f"0 < d* < {self.loop.period_ns}, got {self.loop.fresh_within_ns}"
            )
        for push in self.push:
            parse_push(push)

    @property
    def digest(self) -> bytes:
        """Eight bytes of what both ends must agree on."""
        agreed = repr((self.task, self.robot, self.wbc, self.walk))
        return hashlib.sha256(agreed.encode()).digest()[:8]


@dataclass(frozen=True)
class Push:
    """A force on the base [N], world frame, from `start_ns` for `duration_ns`."""

    force: tuple[float, float, float]
    start_ns: int
    duration_ns: int

    def active(self, time_ns: int) -> bool:
        """Whether it acts at `time_ns` of the task."""
        return self.start_ns <= time_ns < self.start_ns + self.duration_ns


_UNITS_NS = {"us": 1e3, "ms": 1e6, "s": 1e9}
# Times, and forces, beyond this are slips of the pen; they also stay well inside 64 bits of ns.
_MAX_SECONDS = 1e6
_PUSH = re.compile(
    r"(?P<force>[0-9.]+)N@(?P<start>[0-9.]+)s:(?P<duration>[0-9.]+)s:(?P<sign>[+-])(?P<axis>[xyz])"
)


def parse_push(text: str) -> Push:
    """`100N@1.0s:0.2s:+y` → 100 N along +y of the world from 1.0 s for 0.2 s."""
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
            f"(direction ±x, ±y or ±z), or none, got {text!r}"
        ) from None
    force = [0.0, 0.0, 0.0]
    force["xyz".index(match["axis"])] = size if match["sign"] == "+" else -size
    return Push((force[0], force[1], force[2]), round(start * 1e9), round(duration * 1e9))


def parse_duration_ns(text: str) -> int:
    """`30ms`, `1.5s` or `800us` → nanoseconds."""
    match = re.fullmatch(r"([0-9]*\.?[0-9]+)(us|ms|s)", text.strip())
    nanoseconds = float("inf") if match is None else float(match[1]) * _UNITS_NS[match[2]]
    if not nanoseconds <= _MAX_SECONDS * 1e9:
        raise ConfigError(f"expected a duration as in 30ms, 1.5s or 800us, got {text!r}")
    return round(nanoseconds)


def load_config(path: Path | str | None, overrides: dict[str, Any] | None = None) -> RunConfig:
    """A `RunConfig` from a TOML file (None: defaults), with dotted-key overrides on top.

    Keys under `[versions]`, which a run writes into its own copy, are ignored.
    """
    table: dict[str, Any] = {}
    if path is not None:
        try:
            table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"config: cannot read {path}: {error.strerror}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(f"config: {path} is not valid TOML: {error}") from None
        table.pop("versions", None)
    for key, value in (overrides or {}).items():
        _set_dotted(table, key, value)
    preset = _PRESETS.get(table.get("task", RunConfig.task), {})
    config = _build(RunConfig, _merged(preset, table), where="")
    if config.task == "walk" and "duration" not in table:
        config = dataclasses.replace(config, duration=config.walk.duration)
    return config


# What a task changes of the defaults; a file and flags come on top.
_PRESETS: dict[str, dict[str, Any]] = {
    "walk": {
        "push": [],
        "sensors": {"joint_position_noise": 1e-3},
        "wbc": {
            "gains": {
                "com": 20.0,
                "base_orientation": 60.0,
                "posture": 30.0,
                "contact_damping": 30.0,
            },
            "weights": {"base_orientation": 1.0},
        },
        "wire": {"projector_dtype": "float32"},
    }
}


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        both = isinstance(value, dict) and isinstance(under, dict)
        merged[key] = _merged(below[key], value) if both else value
    return merged


def dump_config(config: RunConfig, *, versions: dict[str, str]) -> str:
    """The configuration as TOML that `load_config` reads back to an equal value."""
    return tomli_w.dumps({**dataclasses.asdict(config), "versions": versions})


def _set_dotted(table: dict[str, Any], key: str, value: Any) -> None:
    *sections, name = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise ConfigError(f"{section}: expected a table of settings, got {table!r}")
    table[name] = value


_T = TypeVar("_T")


def _build(cls: type[_T], table: Any, *, where: str) -> _T:
    if not isinstance(table, dict):
        raise ConfigError(f"{where}: expected a table of settings, got {table!r}")
    hints = typing.get_type_hints(cls)
    names = [f.name for f in dataclasses.fields(cls)]  # type: ignore[arg-type]
    values = {}
    for key, value in table.items():
        dotted = f"{where}.{key}" if where else key
        if key not in names:
            raise ConfigError(f"{dotted}: unknown setting; valid here: {', '.join(names)}")
        values[key] = _convert(hints[key], value, where=dotted)
    return cls(**values)


def _convert(hint: Any, value: Any, *, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value, where=where)
    if isinstance(hint, types.GenericAlias):  # tuple[str, ...]
        if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
            raise ConfigError(f"{where}: expected a list of strings, got {value!r}")
        return tuple(value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise ConfigError(f"{where}: expected {hint.__name__}, got {value!r}")
    return value


def _one_of(name: str, value: str, valid: tuple[str, ...]) -> None:
    if value not in valid:
        raise ConfigError(f"{name}: expected one of {', '.join(valid)}, got {value!r}")
