"""Every setting of the project as frozen dataclasses; `config_file` reads them from TOML.

A setting is told in one place, its field: see `setting`. What depends on the robot has Romeo's
value here; another robot's is in its catalogue entry. A value out of range is a
`ConfigError` that says what was expected. Both ends of a link must agree on `task`, `robot`, `wbc`
and `walk`; their digest travels in every message.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter

from shared.config.controllers import CONTROLLERS
from shared.config.quantities import (
    Outage,
    Push,
    parse_angle,
    parse_duration_ns,
    parse_outage,
    parse_push,
)
from shared.config.setting import sections_of, setting
from shared.errors import ConfigError

TASKS = ("balance", "walk")
CORRECTION_LEVELS = ("b", "b_adjoint", "c")

_PUSH = "100N@1.0s:0.2s:+y"


def _robots() -> Sequence[str]:
    # Imported here: a look at a stack that runs should not wait for numpy.
    from shared.robots import CATALOGUE

    return tuple(CATALOGUE)


@dataclass(frozen=True)
class Gains:
    """Feedback gains kp [1/s²], with kd = 2 √kp; the contact rows have damping only."""

    com: float = setting(10.0, help="of the CoM", unit="1/s²", at_least=0.0)
    base_orientation: float = setting(20.0, help="of the base", unit="1/s²", at_least=0.0)
    posture: float = setting(30.0, help="of the joints", unit="1/s²", at_least=0.0)
    contact_damping: float = setting(
        20.0, help="of the soles on the floor", unit="1/s", at_least=0.0
    )
    swing_foot: float = setting(300.0, help="of the foot in the air", unit="1/s²", at_least=0.0)


@dataclass(frozen=True)
class Weights:
    """Task weights ω of Eq. (2a)."""

    com: float = setting(1.0, help="of the CoM", at_least=1e-9)
    base_orientation: float = setting(0.1, help="of the base", at_least=1e-9)
    posture: float = setting(1e-2, help="of the joints", at_least=1e-9)
    force: float = setting(1e-5, help="of the contact forces", at_least=1e-9)
    swing_foot: float = setting(10.0, help="of the foot in the air", at_least=1e-9)


@dataclass(frozen=True)
class WbcConfig:
    """The whole-body QP."""

    gains: Gains = field(default_factory=Gains)
    weights: Weights = field(default_factory=Weights)
    friction: float = setting(0.5, help="the controller's μ", at_least=1e-3)
    min_normal_force: float = setting(1.0, help="per contact point", unit="N", at_least=0.0)
    solver: str = setting("daqp", help="what solves it", choices=("daqp", "proxsuite"))


@dataclass(frozen=True)
class RobotConfig:
    """The robot, by its entry in the catalogue."""

    name: str = setting("romeo", help="which robot", choices=_robots, flag="--robot")
    torque_clamp: float = setting(
        1.45, help="what its actuators may give, × the URDF's effort limits", at_least=0.01
    )


@dataclass(frozen=True)
class PlantConfig:
    """The simulated plant: `mujoco`, or `rigid` with both soles welded to the floor, to balance.

    The other settings are of MuJoCo's contacts.
    """

    kind: str = setting("mujoco", help="what simulates the robot", choices=("mujoco", "rigid"))
    friction: float = setting(0.8, help="between sole and floor", at_least=1e-3)
    contact_time_constant: float = setting(0.005, help="by which they give way, `solref`", unit="s")
    contact_damping_ratio: float = setting(1.0, help="of giving way")


@dataclass(frozen=True)
class SensorConfig:
    """Gaussian noise on what the robot measures."""

    joint_position_noise: float = setting(
        1e-2, help="standard deviation of joint positions", unit="rad", at_least=0.0, flag="--noise"
    )
    joint_velocity_noise: float = setting(
        0.0, help="standard deviation of joint velocities", unit="rad/s", at_least=0.0
    )


@dataclass(frozen=True)
class LoopConfig:
    """The 1 kHz tick.

    On a projector older than `hold_after` the robot holds its joints instead of using the cache:
    more than the outages of the factory and building profiles, less than LA lasts.
    """

    period_ns: int = setting(1_000_000, help="of a tick; no other is supported")
    fresh_within_ns: int = setting(500_000, help="d* of Eq. (7), within the period")
    hold_after: float = setting(
        0.5,
        help="projector age that holds the joints",
        unit="s",
        at_least=0.0,
        may_be_infinite=True,
    )
    edge_compute_ns: int = setting(
        300_000, help="what the edge takes under lockstep, where it is not measured", at_least=0
    )
    connect_timeout: float = setting(
        20.0, help="how long the robot waits for its first projector", unit="s", at_least=0.0
    )


@dataclass(frozen=True)
class LinkConfig:
    """The emulated link.

    After `capacity:` a profile's capacity is replayed instead of its delays: each direction queues
    at most `queue_bytes`, and what finds no room is lost. A message counts as `uplink_bytes` or
    `downlink_bytes`, whatever its own size, where these are not zero. In an `outage`, of the link's
    own time, nothing passes: what is sent then waits for its end.
    """

    network: str = setting(
        "factory/001",
        help="a shipped profile (factory/003), a .npz or .csv file, constant:ROUND_TRIP "
        "(constant:30ms), constant:UP/DOWN, generated:factory/SEED; capacity: before any of them "
        "replays the link behind it; or direct",
        flag="--network",
    )
    loss: float = setting(
        0.0,
        help="probability of losing a message, each way",
        at_least=0.0,
        below=1.0,
        flag="--loss",
    )
    keep_order: bool = setting(
        True, help="a message waits for those sent before it, as in a radio's link layer"
    )
    outage: tuple[str, ...] = setting(
        (),
        help="nothing passes for so long; cut@4s: for ever",
        flag="--outage",
        metavar="389ms@1.2s",
    )
    start: str = setting(
        "",
        help="where in the profile the run begins; empty: at a place that the seed draws",
        flag="--network-start",
        metavar="12.5s",
    )
    uplink_bytes: int = setting(0, help="what a state counts as, 0: as it is", at_least=0)
    downlink_bytes: int = setting(0, help="what an answer counts as, 0: as it is", at_least=0)
    queue_bytes: int = setting(20 * 2**20, help="what finds room in a queue", at_least=1)

    @cached_property
    def start_ns(self) -> int | None:
        """`start` [ns]; None if it is empty."""
        return parse_duration_ns(self.start) if self.start else None

    @cached_property
    def outages(self) -> tuple[Outage, ...]:
        """What `outage` says."""
        return tuple(parse_outage(text) for text in self.outage)


@dataclass(frozen=True)
class WireConfig:
    """What crosses the link."""

    projector_dtype: str = setting(
        "float64", help="numbers of a projector", choices=("float32", "float64")
    )


@dataclass(frozen=True)
class WalkConfig:
    """A walk: equal steps, of which the last brings the feet together.

    A step takes `step_duration`, of which `double_support` on both feet; the paper has 5 ms. The
    CoM trajectory of `dcm` has a closed form, that of `mpc` is by model predictive control.
    """

    steps: int = setting(6, help="how many", at_least=1, flag="--steps")
    step_length: float = setting(
        0.1, help="per step, negative: backward", unit="m", flag="--step-length"
    )
    step_sideways: float = setting(
        0.0, help="per step, positive: to the left", unit="m", flag="--step-sideways"
    )
    step_turn: float = setting(
        0.0,
        help="per step, positive: to the left; as a flag 15deg or 0.26rad",
        unit="rad",
        flag="--step-turn",
        metavar="15deg",
        read=parse_angle,
    )
    step_width: float = setting(
        0.0, help="between the soles, 0: as standing", unit="m", at_least=0.0, flag="--step-width"
    )
    step_duration: float = setting(
        0.8, help="of a step", unit="s", at_least=0.2, flag="--step-duration"
    )
    double_support: float = setting(
        0.02, help="of a step, on both feet", unit="s", at_least=1e-3, flag="--double-support"
    )
    swing_height: float = setting(
        0.05, help="of the foot in the air", unit="m", at_least=0.0, flag="--swing-height"
    )
    begin_duration: float = setting(
        1.0, help="on both feet before the first step", unit="s", at_least=0.5
    )
    end_duration: float = setting(
        2.0, help="on both feet after the last step", unit="s", at_least=0.5
    )
    com_plan: str = setting(
        "dcm", help="how the CoM moves", choices=("dcm", "mpc"), flag="--com-plan"
    )

    @property
    def duration(self) -> float:
        """From standing to standing [s]."""
        return self.begin_duration + self.steps * self.step_duration + self.end_duration


@dataclass(frozen=True)
class SwitchConfig:
    """Contact switches of a walk, Sec. III-C; each part can be turned off.

    `prepare_on_edge`, `prepare_on_board`: the solution of the next contact mode is computed from a
    state `prepare_ns` before the switch, by the edge for the states it gets and once on the robot.
    `solve_on_board`: in a window of `window_ns` centred on the switch the robot solves the full QP
    itself every `period_ns`. The on-board computer is a slow one: what takes a fast core
    `compute_ns` is ready after `compute_time_scale` times as long. The scale is the paper's
    3.7 GHz / 1.2 GHz, and the product its worst case, 2.4 ms (Table V). A preparation that takes
    longer than `prepare_ns` begins earlier, to be ready in time.
    """

    prepare_on_edge: bool = setting(True, help="the next mode by the edge")
    prepare_on_board: bool = setting(True, help="the next mode by the robot")
    solve_on_board: bool = setting(True, help="full QPs by the robot")
    prepare_ns: int = setting(10_000_000, help="how long before the switch", at_least=0)
    window_ns: int = setting(100_000_000, help="of full QPs, centred on the switch", at_least=0)
    period_ns: int = setting(5_000_000, help="between two of them", at_least=1_000_000)
    compute_ns: int = setting(
        780_000, help="what one takes a fast core; live, at least", at_least=0
    )
    compute_time_scale: float = setting(
        3.08, help="the on-board computer is slower by", at_least=0.0
    )

    def ready_after_ns(self, solve_ns: int) -> int:
        """How long the on-board computer takes for what takes a fast core `solve_ns`.

        No less than for the configured `compute_ns`.
        """
        return round(max(solve_ns, self.compute_ns) * self.compute_time_scale)


@dataclass(frozen=True)
class CorrectionConfig:
    """The locally corrected controller.

    `level` is what is exact in a correction: `b` the constraints, `b_adjoint` their gradient too,
    `c` everything, which needs `damping` far from its state.

    The edge factorises the present contact mode and the next one again when the joints are
    `refresh_distance` from where they were, root of the mean square. It sends again after
    `retry_ns`, then ever later, what the robot does not say it holds, or a sign of life.
    `posture_error` moves every joint that far, in a direction that the seed draws, before it
    factorises: how wrong may a factorisation be?

    The contraction estimate decides on which rung the robot stands. Above `refresh_above` the
    on-board computer factorises, if `on_board_budget`, the part of its time for that, is not zero;
    above `stop_above` a walk ends with the step; above `give_up_above` the stale optimum is used
    without a correction.
    """

    level: str = setting("b", help="what is exact", choices=CORRECTION_LEVELS)
    iterations: int = setting(
        1, help="per tick, 0: the stale optimum with a fresh active set", at_least=0
    )
    iterations_at_switch: int = setting(3, help="in the first tick of a contact mode", at_least=0)
    damping: float = setting(
        0.0, help="added to the Hessian that the edge factorises", at_least=0.0
    )
    refresh_distance: float = setting(
        0.15, help="when the edge factorises again", unit="rad", at_least=0.0, may_be_infinite=True
    )
    refresh_interval_ns: int = setting(20_000_000, help="at most that often", at_least=0)
    average_ns: int = setting(
        10_000_000, help="measured joint positions are averaged over, 0: not at all", at_least=0
    )
    retry_ns: int = setting(
        100_000_000, help="sends again what the robot may not hold", at_least=1_000_000
    )
    posture_error: float = setting(0.0, help="of the factorised posture", unit="rad", at_least=0.0)
    relaxation: float = setting(1.0, help="part of a correction that is applied", at_least=0.0)
    on_board_budget: float = setting(
        0.0, help="part of the on-board computer's time for factorising", at_least=0.0, at_most=1.0
    )
    refresh_above: float = setting(
        0.5, help="contraction estimate from which the on-board computer factorises", at_least=0.0
    )
    stop_above: float = setting(
        0.8, help="… from which a walk ends", at_least=0.0, may_be_infinite=True
    )
    give_up_above: float = setting(
        1.0, help="… from which nothing is corrected", at_least=0.0, may_be_infinite=True
    )


@dataclass(frozen=True)
class RunConfig:
    """One run, complete: the same file and seed give the same run."""

    task: str = setting("balance", help="what the robot does", choices=TASKS, flag="--task")
    controller: str = setting(
        "la", help="how it finds its torques", choices=tuple(CONTROLLERS), flag="--controller"
    )
    duration: float = setting(
        5.0,
        help="how long, in simulated time",
        unit="s",
        at_least=1e-3,
        below=1e6,
        flag="--duration",
    )
    seed: int = setting(
        0, help="of noise, loss and the profile's starting point", at_least=0, flag="--seed"
    )
    push: tuple[str, ...] = setting(
        (_PUSH,), help="force on the base, start, duration, direction", flag="--push", metavar=_PUSH
    )
    view: str = setting(
        "auto", help="where it is watched", choices=("auto", "native", "web", "off"), flag="--view"
    )
    robot: RobotConfig = field(default_factory=RobotConfig)
    wbc: WbcConfig = field(default_factory=WbcConfig)
    walk: WalkConfig = field(default_factory=WalkConfig)
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
            raise ConfigError("loop.period_ns: only 1000000 (1 kHz) is supported")
        if not 0 < self.loop.fresh_within_ns < self.loop.period_ns:
            raise ConfigError(
                "loop.fresh_within_ns: expected a deadline inside the period, "
                f"0 < d* < {self.loop.period_ns}, got {self.loop.fresh_within_ns}"
            )
        if self.task == "walk" and self.wire.projector_dtype == "float64":
            raise ConfigError(
                "wire.projector_dtype: expected float32 for a walk, where one message of at most "
                "40 kB has the projectors of several contact modes, got 'float64'"
            )
        if self.task == "walk" and self.plant.kind == "rigid":
            raise ConfigError(
                "plant.kind: expected mujoco for a walk, because the feet of a rigid plant are "
                "welded to the floor, got 'rigid'"
            )
        # Read here, where one in another form can still be refused.
        _ = self.pushes, self.link.outages, self.link.start_ns

    @cached_property
    def pushes(self) -> tuple[Push, ...]:
        """What `push` says."""
        return tuple(parse_push(text) for text in self.push)

    @property
    def digest(self) -> bytes:
        """Eight bytes of what both ends must agree on."""
        agreed = repr((self.task, self.robot, self.wbc, self.walk))
        return hashlib.sha256(agreed.encode()).digest()[:8]


SECTIONS = tuple(sections_of(RunConfig))
SETTINGS = {key: each for section in SECTIONS for key, each in section.settings.items()}
