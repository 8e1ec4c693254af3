"""All settings of a run as one frozen dataclass; `config_file` reads them from TOML.

The tables are dataclasses in the files `*_settings`: of the controller, steps, robot and link. A
setting is described in one place, its field: see `setting`. Settings that depend on the robot
have Romeo's values here; another robot's are in its robot file. A value out of range is a
`ConfigError` that gives the range. Both ends of a link must agree on `task`, `ground`, `robot`,
`wbc`, `walk` and `stepping`; their digest travels in every message.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter

from shared.config.control_settings import CorrectionConfig, SwitchConfig, WbcConfig
from shared.config.extensions import CONTROLLERS, TABLES, TASKS
from shared.config.link_settings import LinkConfig, LoopConfig, WireConfig
from shared.config.quantities import Push, parse_ground, parse_push
from shared.config.robot_settings import PlantConfig, RobotConfig, SensorConfig
from shared.config.setting import sections_of, setting
from shared.config.step_settings import SteppingConfig, WalkConfig
from shared.errors import ConfigError
from shared.extensions import Names
from shared.robots.catalogue import ROBOTS

WALKS = ("walk", "go")

_PUSH = "100N@1.0s:0.2s:+y"
# The least time of a step on one foot [s].
_LEAST_SWING = 0.1


@dataclass(frozen=True)
class RunConfig:
    """All settings of a run. The same file and seed give the same run."""

    task: str = setting("balance", help="the robot's task", choices=TASKS, flag="--task")
    controller: str = setting(
        "la", help="the robot's controller", choices=CONTROLLERS, flag="--controller"
    )
    duration: float = setting(
        5.0,
        help="duration in simulated time",
        unit="s",
        at_least=1e-3,
        below=1e6,
        flag="--duration",
        short="--for",
    )
    seed: int = setting(
        0,
        help="seed of noise, loss, the profile's starting point and blocks",
        at_least=0,
        flag="--seed",
    )
    ground: str = setting(
        "flat",
        help="the ground, which plan and plant know: flat, blocks:2cm, stairs:3x6cm, gap:10cm, "
        "slope:8deg or FILE.npz",
        flag="--ground",
        metavar="stairs:3x6cm",
    )
    push: tuple[str, ...] = setting(
        (_PUSH,),
        help="push on the base: force, start, duration, direction",
        flag="--push",
        metavar=_PUSH,
    )
    view: str = setting(
        "auto",
        help="where the run is shown",
        choices=("auto", "native", "web", "page", "off"),
        flag="--view",
    )
    robot: RobotConfig = field(default_factory=RobotConfig)
    wbc: WbcConfig = field(default_factory=WbcConfig)
    walk: WalkConfig = field(default_factory=WalkConfig)
    stepping: SteppingConfig = field(default_factory=SteppingConfig)
    switch: SwitchConfig = field(default_factory=SwitchConfig)
    correction: CorrectionConfig = field(default_factory=CorrectionConfig)
    plant: PlantConfig = field(default_factory=PlantConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    link: LinkConfig = field(default_factory=LinkConfig)
    wire: WireConfig = field(default_factory=WireConfig)

    def __post_init__(self) -> None:
        for key, each in SETTINGS.items():
            each.check(key, attrgetter(key)(self))
        if self.loop.period_ns != 1_000_000:
            raise ConfigError(
                f"loop.period_ns: expected 1000000 (1 kHz), got {self.loop.period_ns}"
            )
        if not 0 < self.loop.fresh_within_ns < self.loop.period_ns:
            raise ConfigError(
                "loop.fresh_within_ns: expected a deadline inside the period, "
                f"0 < d* < {self.loop.period_ns}, got {self.loop.fresh_within_ns}"
            )
        longest = self.walk.step_duration - _LEAST_SWING
        if self.walks and self.walk.double_support > longest:
            raise ConfigError(
                f"walk.double_support: expected at most {longest:g} s, {_LEAST_SWING:g} s less "
                f"than walk.step_duration, got {self.walk.double_support:g}; try longer steps"
            )
        if self.walks and self.wire.projector_dtype == "float64":
            raise ConfigError(
                "wire.projector_dtype: expected float32 for a walk, where one message of at most "
                "40 kB has the projectors of several contact modes, got 'float64'"
            )
        if self.walks and self.plant.kind == "rigid":
            raise ConfigError(
                "plant.kind: expected mujoco for a walk, because the feet of a rigid plant are "
                "welded to the floor, got 'rigid'"
            )
        if self.task == "walk" and parse_ground(self.ground).kind != "flat":
            raise ConfigError(
                "ground: expected flat for the equal steps of a walk, which look at no ground, got "
                f"{self.ground!r}; try --task go, or --unknown-ground"
            )
        if {parse_ground(self.ground).kind, parse_ground(self.plant_ground).kind} != {"flat"} and (
            self.plant.kind == "rigid"
        ):
            raise ConfigError(
                "plant.kind: expected mujoco on a ground that is not flat, because the rigid plant "
                "has flat ground only, got 'rigid'"
            )
        if self.stepping.mode != "off":
            self._check_stepping()
        # Parsed here, so that a malformed text is refused at once.
        _ = self.pushes, self.link.outages, self.link.start_ns, self.walk.place

    @property
    def walks(self) -> bool:
        """Return whether the task is a walk: equal steps, or to a goal."""
        return self.task in WALKS

    @property
    def plant_ground(self) -> str:
        """The description of the plant's ground."""
        return self.plant.unknown_ground or self.ground

    def _check_stepping(self) -> None:
        if self.wbc.balance.law != "dcm":
            raise ConfigError(
                "stepping.mode: expected wbc.balance.law = 'dcm' for a robot that steps, got "
                f"{self.wbc.balance.law!r}; try wbc.weights.com = 10 with it"
            )
        if self.plant.kind == "rigid":
            raise ConfigError(
                "plant.kind: expected mujoco for a robot that steps, because the feet of a rigid "
                "plant are welded to the floor, got 'rigid'"
            )
        if self.task not in ("balance", "walk", "go"):
            raise ConfigError(
                f"stepping.mode: expected the task balance, walk or go, got {self.task!r}"
            )
        if parse_ground(self.ground).kind != "flat" and self.task != "go":
            raise ConfigError(
                "ground: expected flat for a robot that decides on its steps in the task "
                f"{self.task}, got {self.ground!r}; try --task go, or --unknown-ground"
            )

    @cached_property
    def pushes(self) -> tuple[Push, ...]:
        """The pushes that `push` describes."""
        return tuple(parse_push(text) for text in self.push)

    @property
    def digest(self) -> bytes:
        """The digest of the settings on which both ends must agree, eight bytes."""
        # A file may lie elsewhere on the other machine: it counts by its content.
        task = self.task if self.task in TASKS.own else TASKS.identity(self.task)
        ground = self.ground.rpartition("/")[2]
        robot = self.robot
        if robot.name not in ROBOTS.own:  # the robot's file may too, so its content counts
            robot = replace(robot, name=f"{robot.label} {ROBOTS.identity(robot.name)}")
        steps = () if self.stepping.mode == "off" else (self.stepping,)
        agreed = repr((task, ground, robot, self.wbc, self.walk, *steps))
        return hashlib.sha256(agreed.encode()).digest()[:8]


def extended(config: RunConfig) -> list[tuple[Names, str]]:
    """Return the tables and values of a run's controller, task, plant and robot that are not the
    project's.
    """
    values = [(table, attrgetter(key)(config)) for key, table in TABLES.items()]
    return [(table, value) for table, value in values if value not in table.own]


SECTIONS = tuple(sections_of(RunConfig))
SETTINGS = {key: each for section in SECTIONS for key, each in section.settings.items()}
