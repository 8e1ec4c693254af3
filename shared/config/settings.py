"""Every setting of the project as frozen dataclasses; `config_file` reads them from TOML.

What depends on the robot has Romeo's value here; another robot's is in its catalogue entry.
A value out of range is a `ConfigError` that says what was expected. Both ends of a link must agree
on `task`, `robot`, `wbc` and `walk`; their digest travels in every message.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from functools import cached_property

from shared.config.controllers import CONTROLLERS
from shared.config.quantities import Outage, Push, parse_outage, parse_push
from shared.errors import ConfigError

TASKS = ("balance", "walk")
CORRECTION_LEVELS = ("b", "b_adjoint", "c")
COM_PLANS = ("dcm", "mpc")
PLANTS = ("mujoco", "rigid")
VIEWS = ("auto", "native", "web", "off")


# Infinite means never.
_MAY_BE_INFINITE = (
    "loop.hold_after",
    "correction.refresh_distance",
    "correction.stop_above",
    "correction.give_up_above",
)


@dataclass(frozen=True)
class Gains:
    """Feedback gains: kp [1/s²], kd = 2 √kp; the contact rows have damping only [1/s]."""

    com: float = 10.0
    base_orientation: float = 20.0
    posture: float = 30.0
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
    """The simulated plant: `mujoco`, or `rigid` with both soles welded to the floor, to balance.

    MuJoCo's contacts have a `friction`, and give way by a time constant [s] and a damping ratio.
    """

    kind: str = "mujoco"
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

    After `capacity:` a profile's capacity is replayed instead of its delays: each direction queues
    at most `queue_bytes`, and what finds no room is lost. A message counts as `uplink_bytes` or
    `downlink_bytes`, whatever its own size, where these are not zero.

    `loss` is an independent loss probability per message, each way. `keep_order` holds a message
    back until those sent before it have left, as a radio link layer does. In an `outage`, of the
    link's own time, nothing passes: what is sent then waits for its end.
    """

    network: str = "factory/001"
    loss: float = 0.0
    keep_order: bool = True
    outage: tuple[str, ...] = ()
    uplink_bytes: int = 0
    downlink_bytes: int = 0
    queue_bytes: int = 20 * 2**20

    @cached_property
    def outages(self) -> tuple[Outage, ...]:
        """What `outage` says."""
        return tuple(parse_outage(text) for text in self.outage)


@dataclass(frozen=True)
class WireConfig:
    """`projector_dtype` is `float64` or `float32`."""

    projector_dtype: str = "float64"


@dataclass(frozen=True)
class WalkConfig:
    """A walk: steps of (length, sideways) [m] and turn [rad] each, negative for the other way.

    `step_width` [m] is the distance of the soles side by side, 0 for that of standing. A step takes
    `step_duration` [s], of which `double_support` on both feet; the paper has 5 ms. The walk begins
    and ends on both feet for `begin_duration` and `end_duration` [s]. `com_plan` is how the CoM
    trajectory is made: `dcm` in closed form, `mpc` by model predictive control.
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
    com_plan: str = "dcm"

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
    itself every `period_ns`. The on-board computer is a slow one: what takes a fast core
    `compute_ns` is ready after `compute_time_scale` times as long. The scale is the paper's
    3.7 GHz / 1.2 GHz, and the product its worst case, 2.4 ms (Table V). A preparation that takes
    longer than `prepare_ns` begins earlier, to be ready in time.
    """

    prepare_on_edge: bool = True
    prepare_on_board: bool = True
    solve_on_board: bool = True
    prepare_ns: int = 10_000_000
    window_ns: int = 100_000_000
    period_ns: int = 5_000_000
    compute_ns: int = 780_000
    compute_time_scale: float = 3.08

    def ready_after_ns(self, solve_ns: int) -> int:
        """How long the on-board computer takes for what takes a fast core `solve_ns`.

        No less than for the configured `compute_ns`.
        """
        return round(max(solve_ns, self.compute_ns) * self.compute_time_scale)


@dataclass(frozen=True)
class CorrectionConfig:
    """The locally corrected controller.

    `level` is what is exact in a correction: `b` the constraints, `b_adjoint` their gradient too,
    `c` everything. `iterations` per tick, none for a stale optimum with a fresh active set;
    `iterations_at_switch` in the first tick of a contact mode. `damping` is added to the Hessian
    that the edge factorises, for level c far from its state.

    The edge factorises the present contact mode and the next one again when the joints are
    `refresh_distance` [rad] from where they were, root of the mean square, at most once per
    `refresh_interval_ns`; measured positions are averaged over `average_ns`, 0 for not at all. It
    sends again after `retry_ns`, then ever later, what the robot does not say it holds, or a sign
    of life. `posture_error` moves every joint that far, in a direction that the seed draws, before
    it factorises [rad]: how wrong may a factorisation be?
    `relaxation` is the part of a correction that is applied.

    The contraction estimate decides on which rung the robot stands. Above `refresh_above` the
    on-board computer factorises, if `on_board_budget`, the part of its time for that, is not zero;
    above `stop_above` a walk ends with the step; above `give_up_above` the stale optimum is used
    without a correction.
    """

    level: str = "b"
    iterations: int = 1
    iterations_at_switch: int = 3
    damping: float = 0.0
    refresh_distance: float = 0.15
    refresh_interval_ns: int = 20_000_000
    average_ns: int = 10_000_000
    retry_ns: int = 100_000_000
    posture_error: float = 0.0
    relaxation: float = 1.0
    on_board_budget: float = 0.0
    refresh_above: float = 0.5
    stop_above: float = 0.8
    give_up_above: float = 1.0


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
    correction: CorrectionConfig = field(default_factory=CorrectionConfig)
    plant: PlantConfig = field(default_factory=PlantConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    link: LinkConfig = field(default_factory=LinkConfig)
    wire: WireConfig = field(default_factory=WireConfig)

    def __post_init__(self) -> None:
        _one_of("task", self.task, TASKS)
        _one_of("controller", self.controller, tuple(CONTROLLERS))
        _one_of("view", self.view, VIEWS)
        _one_of("walk.com_plan", self.walk.com_plan, COM_PLANS)
        _one_of("plant.kind", self.plant.kind, PLANTS)
        _one_of("correction.level", self.correction.level, CORRECTION_LEVELS)
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
            ("switch.compute_time_scale", self.switch.compute_time_scale, 0.0),
            ("correction.iterations", self.correction.iterations, 0),
            ("correction.iterations_at_switch", self.correction.iterations_at_switch, 0),
            ("correction.damping", self.correction.damping, 0.0),
            ("correction.refresh_distance", self.correction.refresh_distance, 0.0),
            ("correction.posture_error", self.correction.posture_error, 0.0),
            *(
                (f"correction.{name}", getattr(self.correction, name), 0.0)
                for name in (
                    "relaxation",
                    "on_board_budget",
                    "refresh_above",
                    "stop_above",
                    "give_up_above",
                )
            ),
            ("correction.refresh_interval_ns", self.correction.refresh_interval_ns, 0),
            ("correction.average_ns", self.correction.average_ns, 0),
            ("correction.retry_ns", self.correction.retry_ns, 1_000_000),
            ("plant.friction", self.plant.friction, 1e-3),
            ("loop.connect_timeout", self.loop.connect_timeout, 0.0),
            ("loop.hold_after", self.loop.hold_after, 0.0),
            ("loop.edge_compute_ns", self.loop.edge_compute_ns, 0),
            ("link.loss", self.link.loss, 0.0),
            ("link.uplink_bytes", self.link.uplink_bytes, 0),
            ("link.downlink_bytes", self.link.downlink_bytes, 0),
            ("link.queue_bytes", self.link.queue_bytes, 1),
        ):
            finite = math.isfinite(value) or name in _MAY_BE_INFINITE
            if not (value >= low and finite):
                raise ConfigError(f"{name}: expected a number ≥ {low:g}, got {value!r}")
        if not self.link.loss < 1.0:
            raise ConfigError(f"link.loss: expected a probability below 1, got {self.link.loss}")
        if not self.correction.on_board_budget <= 1.0:
            raise ConfigError(
                "correction.on_board_budget: expected a part of the on-board computer's time, at "
                f"most 1, got {self.correction.on_board_budget}"
            )
        if not self.duration < 1e6:
            raise ConfigError(f"duration: expected less than 1e6 s, got {self.duration}")
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
        _ = self.pushes, self.link.outages

    @cached_property
    def pushes(self) -> tuple[Push, ...]:
        """What `push` says."""
        return tuple(parse_push(text) for text in self.push)

    @property
    def digest(self) -> bytes:
        """Eight bytes of what both ends must agree on."""
        agreed = repr((self.task, self.robot, self.wbc, self.walk))
        return hashlib.sha256(agreed.encode()).digest()[:8]


def _one_of(name: str, value: str, valid: tuple[str, ...]) -> None:
    if value not in valid:
        raise ConfigError(f"{name}: expected one of {', '.join(valid)}, got {value!r}")
