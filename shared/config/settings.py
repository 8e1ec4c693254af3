"""Every setting of the project as frozen dataclasses; `config_file` reads them from TOML.

A setting is described in one place, its field: see `setting`. Settings that depend on the robot
have Romeo's values here; another robot's are in its robot file. A value out of range is a
`ConfigError` that gives the range. Both ends of a link must agree on `task`, `ground`, `robot`,
`wbc`, `walk` and `stepping`; their digest travels in every message.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter

from shared.config.extensions import CONTROLLERS, PLANTS, TABLES, TASKS
from shared.config.quantities import (
    Goal,
    Outage,
    Push,
    parse_angle,
    parse_duration_ns,
    parse_goal,
    parse_ground,
    parse_outage,
    parse_push,
)
from shared.config.setting import sections_of, setting
from shared.errors import ConfigError
from shared.extensions import Names
from shared.robots.catalogue import ROBOTS

WALKS = ("walk", "go")
CORRECTION_LEVELS = ("b", "b_adjoint", "c")

_PUSH = "100N@1.0s:0.2s:+y"
# The least time of a step on one foot [s].
_LEAST_SWING = 0.1


@dataclass(frozen=True)
class Gains:
    """Feedback gains kp [1/s²], with kd = 2 √kp; the contact rows have damping only."""

    com: float = setting(10.0, help="gain of the CoM", unit="1/s²", at_least=0.0)
    base_orientation: float = setting(20.0, help="gain of the base", unit="1/s²", at_least=0.0)
    posture: float = setting(30.0, help="gain of the joints", unit="1/s²", at_least=0.0)
    contact_damping: float = setting(
        20.0, help="damping of the soles on the floor", unit="1/s", at_least=0.0
    )
    swing_foot: float = setting(300.0, help="gain of the swing foot", unit="1/s²", at_least=0.0)
    angular_momentum: float = setting(
        10.0, help="gain of the angular momentum", unit="1/s", at_least=0.0
    )


@dataclass(frozen=True)
class Weights:
    """Task weights ω of Eq. (2a). Without a weight, angular momentum and CoP are no tasks."""

    com: float = setting(1.0, help="weight of the CoM", at_least=1e-9)
    base_orientation: float = setting(0.1, help="weight of the base", at_least=1e-9)
    posture: float = setting(1e-2, help="weight of the joints", at_least=1e-9)
    force: float = setting(1e-5, help="weight of the contact forces", at_least=1e-9)
    swing_foot: float = setting(10.0, help="weight of the swing foot", at_least=1e-9)
    angular_momentum: float = setting(0.0, help="weight of the angular momentum", at_least=0.0)
    cop: float = setting(0.0, help="weight of the centre of pressure", at_least=0.0)


@dataclass(frozen=True)
class LimitsConfig:
    """The robot's own limits in the QP.

    A joint has to come to rest `position_margin` before the end of its range.
    """

    torque: bool = setting(False, help="the QP keeps joint torques below the clamp")
    position: bool = setting(False, help="the QP keeps joints within their range")
    velocity: bool = setting(False, help="the QP keeps joints below their velocity limits")
    torque_fraction: float = setting(
        0.98, help="largest joint torque of the QP, × the clamp", at_least=0.01, at_most=1.0
    )
    position_margin: float = setting(
        0.08, help="distance of the limit from the end of a joint's range", unit="rad", at_least=0.0
    )


@dataclass(frozen=True)
class BalanceConfig:
    """The feedback of the CoM.

    `com` is the task's own, with `gains.com`. `dcm` commands the centre of pressure (CoP) by the
    divergent component of motion. It may command the CoP `beyond` the support, which turns the
    trunk. An observer adds the estimated external force if it shifts the CoP by more than
    `dead_band`. `dcm` needs a weight of the CoM of about 10.
    """

    law: str = setting("com", help="feedback of the CoM in the plane", choices=("com", "dcm"))
    gain: float = setting(8.0, help="gain of the DCM", unit="1/s", at_least=0.0)
    beyond: float = setting(
        0.075, help="distance of a commanded CoP beyond the support", unit="m", at_least=0.0
    )
    observer_time: float = setting(
        0.01, help="time constant of the observer, 0: no observer", unit="s", at_least=0.0
    )
    dead_band: float = setting(
        0.06, help="least shift of the CoP by the observer", unit="m", at_least=0.0
    )


@dataclass(frozen=True)
class WbcConfig:
    """The whole-body QP."""

    gains: Gains = field(default_factory=Gains)
    weights: Weights = field(default_factory=Weights)
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    balance: BalanceConfig = field(default_factory=BalanceConfig)
    friction: float = setting(0.5, help="friction μ that the controller assumes", at_least=1e-3)
    min_normal_force: float = setting(
        1.0, help="least normal force of a contact point", unit="N", at_least=0.0
    )
    solver: str = setting("daqp", help="solver of the QP", choices=("daqp", "proxsuite"))


@dataclass(frozen=True)
class RobotConfig:
    """The robot, by its name or its robot file."""

    name: str = setting("romeo", help="the robot", choices=ROBOTS, flag="--robot")
    torque_clamp: float = setting(
        1.45, help="limit on a commanded torque, × the URDF's effort limit", at_least=0.01
    )

    @property
    def label(self) -> str:
        """The robot's name on the link, in titles and tables."""
        return ROBOTS.label(self.name)


@dataclass(frozen=True)
class PlantConfig:
    """The simulated plant: `mujoco`, or `rigid` with both soles welded to the floor, for balance.

    The other settings are for MuJoCo. The plant's ground is the planned one, unless there is an
    `unknown_ground`.
    """

    kind: str = setting("mujoco", help="kind of plant", choices=PLANTS, flag="--plant")
    friction: float = setting(0.8, help="friction μ between sole and floor", at_least=1e-3)
    contact_time_constant: float = setting(
        0.005, help="time constant of a contact, in `solref`", unit="s"
    )
    contact_damping_ratio: float = setting(1.0, help="damping ratio of a contact, in `solref`")
    joint_limits: bool = setting(False, help="joints stop at the URDF's position limits")
    velocity_limits: bool = setting(
        False, help="a motor at the URDF's velocity limit drives its joint no faster"
    )
    leg_collision: bool = setting(False, help="the legs collide with each other")
    unknown_ground: str = setting(
        "",
        help="the plant's ground in place of the planned one, in the same forms",
        flag="--unknown-ground",
        metavar="blocks:2cm",
    )


@dataclass(frozen=True)
class SensorConfig:
    """Errors of the robot's measurements.

    Noise is Gaussian and new in each tick. The seed draws the bias of a run, with the setting as
    its standard deviation. The drift is a random walk.
    """

    joint_position_noise: float = setting(
        1e-2, help="standard deviation of joint positions", unit="rad", at_least=0.0, flag="--noise"
    )
    joint_velocity_noise: float = setting(
        0.0, help="standard deviation of joint velocities", unit="rad/s", at_least=0.0
    )
    base_position_noise: float = setting(
        0.0, help="standard deviation of the base's position", unit="m", at_least=0.0
    )
    base_position_drift: float = setting(
        0.0, help="drift of the base's position in a second", unit="m/√s", at_least=0.0
    )
    base_velocity_noise: float = setting(
        0.0, help="standard deviation of the base's velocity", unit="m/s", at_least=0.0
    )
    tilt_noise: float = setting(
        0.0, help="standard deviation of the base's orientation", unit="rad", at_least=0.0
    )
    tilt_bias: float = setting(0.0, help="bias of the base's orientation", unit="rad", at_least=0.0)
    gyro_noise: float = setting(
        0.0, help="standard deviation of the base's angular velocity", unit="rad/s", at_least=0.0
    )
    gyro_bias: float = setting(
        0.0, help="bias of the base's angular velocity", unit="rad/s", at_least=0.0
    )
    measure_forces: bool = setting(False, help="the robot measures the forces on its feet")
    force_noise: float = setting(
        0.0, help="standard deviation of a foot's measured force", unit="N", at_least=0.0
    )


@dataclass(frozen=True)
class LoopConfig:
    """The 1 kHz tick.

    If its newest projector is older than `hold_after`, the robot holds its joints. The default is
    longer than the outages of the factory and building profiles, and shorter than LA can stand.

    If nothing has come from the other end of a `tcp/` connection for `link_lease`, the connection
    is closed and made again. So is a `tls/` connection on Linux, if nothing is acknowledged. Each
    end tells the other one its own `link_lease`.
    """

    period_ns: int = setting(1_000_000, help="length of a tick; no other value is supported")
    fresh_within_ns: int = setting(500_000, help="deadline d* of Eq. (7), within the period")
    hold_after: float = setting(
        0.5,
        help="projector age above which the robot holds its joints",
        unit="s",
        at_least=0.0,
        may_be_infinite=True,
    )
    edge_compute_ns: int = setting(
        300_000, help="the edge's computing time in lockstep, where none is measured", at_least=0
    )
    connect_timeout: float = setting(
        20.0, help="time that the robot waits for its first projector", unit="s", at_least=0.0
    )
    link_lease: float = setting(
        1.0,
        help="silence after which a tcp/ or tls/ connection is made again",
        unit="s",
        at_least=0.2,
    )


@dataclass(frozen=True)
class LinkConfig:
    """The emulated link.

    With `capacity:` before a profile, its capacity is replayed instead of its delays. Then each
    direction queues at most `queue_bytes`, and a message that finds no room is lost. If
    `uplink_bytes` or `downlink_bytes` is not zero, a message counts as that size instead of its
    real one. During an `outage`, in the link's own time, no message passes: a message sent then
    waits for its end.
    """

    network: str = setting(
        "factory/001",
        help="a shipped profile (factory/003), a .npz or .csv file, constant:ROUND_TRIP "
        "(constant:30ms), constant:UP/DOWN, generated:factory/SEED; any of them after capacity: "
        "to replay its capacity; or direct, without a shim",
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
        True, help="messages arrive in the order of sending, as in a radio's link layer"
    )
    outage: tuple[str, ...] = setting(
        (),
        help="duration and start of an outage; cut@4s: for ever",
        flag="--outage",
        metavar="389ms@1.2s",
    )
    start: str = setting(
        "",
        help="start of the run in the profile; empty: the seed draws it",
        flag="--network-start",
        metavar="12.5s",
    )
    uplink_bytes: int = setting(0, help="size of a state, 0: its real size", at_least=0)
    downlink_bytes: int = setting(0, help="size of an answer, 0: its real size", at_least=0)
    queue_bytes: int = setting(20 * 2**20, help="size of a direction's queue", at_least=1)

    @cached_property
    def start_ns(self) -> int | None:
        """`start` [ns]; None if it is empty."""
        return parse_duration_ns(self.start) if self.start else None

    @cached_property
    def outages(self) -> tuple[Outage, ...]:
        """The outages that `outage` describes."""
        return tuple(parse_outage(text) for text in self.outage)


@dataclass(frozen=True)
class WireConfig:
    """The format of messages."""

    projector_dtype: str = setting(
        "float64", help="type of a projector's numbers", choices=("float32", "float64")
    )


@dataclass(frozen=True)
class WalkConfig:
    """A walk of equal steps, or to a goal. The last step brings the feet together.

    The task `walk` takes `steps` equal steps. The task `go` finds steps to `goal` over the ground
    that it knows. Their length forward is at most `step_length`. The heading of the goal may be
    left out. A step takes `step_duration`. For `double_support` of it the robot stands on both
    feet, in the paper for 5 ms. `dcm` plans the CoM in closed form, `mpc` by model predictive
    control.
    """

    steps: int = setting(6, help="number of steps", at_least=1, at_most=1000, flag="--steps")
    step_length: float = setting(
        0.1, help="length of a step, negative: backward", unit="m", flag="--step-length"
    )
    step_sideways: float = setting(
        0.0, help="sideways part of a step, positive: to the left", unit="m", flag="--step-sideways"
    )
    step_turn: float = setting(
        0.0,
        help="turn of a step, positive: to the left; as a flag 15deg or 0.26rad",
        unit="rad",
        flag="--step-turn",
        metavar="15deg",
        read=parse_angle,
    )
    step_width: float = setting(
        0.0,
        help="distance between the soles, 0: as standing",
        unit="m",
        at_least=0.0,
        flag="--step-width",
    )
    step_duration: float = setting(
        0.8,
        help="duration of a step",
        unit="s",
        at_least=0.2,
        at_most=10.0,
        flag="--step-duration",
    )
    double_support: float = setting(
        0.02,
        help="time of a step on both feet",
        unit="s",
        at_least=1e-3,
        at_most=10.0,
        flag="--double-support",
    )
    swing_height: float = setting(
        0.05, help="height of the swing foot", unit="m", at_least=0.0, flag="--swing-height"
    )
    begin_duration: float = setting(
        1.0, help="time on both feet before the first step", unit="s", at_least=0.5, at_most=60.0
    )
    end_duration: float = setting(
        2.0, help="time on both feet after the last step", unit="s", at_least=0.5, at_most=60.0
    )
    com_plan: str = setting(
        "dcm", help="planner of the CoM", choices=("dcm", "mpc"), flag="--com-plan"
    )
    com_lowering: float = setting(
        0.0,
        help="distance of the CoM below its height in standing, for longer steps and higher stairs",
        unit="m",
        at_least=0.0,
        at_most=0.3,
        flag="--com-lowering",
    )
    goal: str = setting(
        "1,0,0deg",
        help="place and heading to go to, with --task go",
        flag="--goal",
        metavar="2,0.5,90deg",
    )

    @property
    def duration(self) -> float:
        """The duration from standing to standing [s]."""
        return self.begin_duration + self.steps * self.step_duration + self.end_duration

    @cached_property
    def place(self) -> Goal:
        """The place that `goal` describes."""
        return parse_goal(self.goal)


@dataclass(frozen=True)
class SteppingConfig:
    """Steps that the robot decides on by itself.

    The robot predicts the divergent component of motion `ahead` from now. It steps if the
    prediction is outside the support; to the left or right it must be `beyond_sideways` outside,
    because the hip strategy helps longer there. The robot decides anew every `period_ns`, until
    `freeze` before the swing foot lands. A foot counts as loaded when its measured force exceeds
    `landing_force`. Both feet then stay loaded for at least `double_support`. No foot of LA or PR
    lifts into a stalled link: see `lift_within`.
    """

    mode: str = setting(
        "off",
        help="decisions on steps: off, on the robot, or by the edge alone",
        choices=("off", "on", "edge"),
        flag="--stepping",
    )
    ahead: float = setting(
        0.06, help="time ahead for which the DCM is predicted", unit="s", at_least=0.0, at_most=1.0
    )
    beyond_sideways: float = setting(
        0.05,
        help="distance of the DCM beside the support above which it steps",
        unit="m",
        at_least=0.0,
    )
    force_lasts: float = setting(
        0.03, help="expected further duration of an external force", unit="s", at_least=0.0
    )
    period_ns: int = setting(5_000_000, help="period of decisions", at_least=1_000_000)
    freeze: float = setting(
        0.05,
        help="time before the landing from which on the foothold is fixed",
        unit="s",
        at_least=0.01,
    )
    landing_force: float = setting(
        40.0, help="force at which a foot counts as loaded", unit="N", at_least=1.0
    )
    double_support: float = setting(
        0.03, help="least time on both feet between steps", unit="s", at_least=0.0
    )
    swing_height: float = setting(0.04, help="height of the swing foot", unit="m", at_least=0.0)
    lift_within: float = setting(
        0.5,
        help="age of the newest answer up to which a foot of LA or PR lifts, × `loop.hold_after`",
        at_least=0.0,
        may_be_infinite=True,
    )


@dataclass(frozen=True)
class SwitchConfig:
    """Contact switches of a walk, Sec. III-C; each part can be turned off.

    With `prepare_on_edge`, the edge solves for the next contact mode too, from each state in the
    last `prepare_ns` before the switch. With `prepare_on_board`, the robot does so once, from the
    state `prepare_ns` before the switch. With `solve_on_board`, the robot solves the full QP every
    `period_ns`, in a window of `window_ns` centred on the switch. The on-board computer is slow: it
    takes `compute_time_scale` times as long as a fast core, which takes `compute_ns`. The scale is
    the paper's 3.7 GHz over 1.2 GHz. The product of both is the paper's worst case, 2.4 ms (Table
    V). If the robot needs longer than `prepare_ns`, it begins earlier, to be ready in time.
    """

    prepare_on_edge: bool = setting(True, help="the edge prepares the next mode")
    prepare_on_board: bool = setting(True, help="the robot prepares the next mode")
    solve_on_board: bool = setting(True, help="the robot solves full QPs")
    prepare_ns: int = setting(
        10_000_000, help="time before the switch to prepare the next mode", at_least=0
    )
    window_ns: int = setting(
        100_000_000, help="window of full QPs, centred on the switch", at_least=0
    )
    period_ns: int = setting(5_000_000, help="period of full QPs", at_least=1_000_000)
    compute_ns: int = setting(
        780_000, help="time of a full QP on a fast core; in a live run the least time", at_least=0
    )
    compute_time_scale: float = setting(
        3.08, help="time of the on-board computer, × a fast core's", at_least=0.0
    )

    def ready_after_ns(self, solve_ns: int) -> int:
        """Return the on-board computer's time for a QP that takes a fast core `solve_ns` [ns].

        It is at least the time for the configured `compute_ns`.
        """
        return round(max(solve_ns, self.compute_ns) * self.compute_time_scale)


@dataclass(frozen=True)
class CorrectionConfig:
    """The locally corrected controller.

    `level` says which part of a correction is exact: `b` the constraints, `b_adjoint` also their
    gradient, `c` everything. Level `c` needs `damping` far from the state of the factorisation.

    When the joints have moved by `refresh_distance`, root mean square, the edge factorises the
    present contact mode and the next one again. If the robot does not report that it holds a
    factorisation, the edge sends it again after `retry_ns`, then at growing intervals. If it has
    sent nothing for `retry_ns`, it sends a sign of life. `posture_error` moves every joint by this
    angle before the edge factorises. The seed draws the direction. It shows how wrong a
    factorisation may be.

    The contraction estimate decides how the robot falls back. Above `refresh_above` the on-board
    computer factorises, for the part `on_board_budget` of its time. Above `stop_above` a walk ends
    with the step. Above `give_up_above` the robot uses the stale optimum without a correction.
    """

    level: str = setting("b", help="part of a correction that is exact", choices=CORRECTION_LEVELS)
    iterations: int = setting(
        1, help="corrections per tick, 0: the stale optimum with a fresh active set", at_least=0
    )
    iterations_at_switch: int = setting(
        3, help="corrections in the first tick of a contact mode", at_least=0
    )
    damping: float = setting(
        0.0, help="damping added to the Hessian that the edge factorises", at_least=0.0
    )
    refresh_distance: float = setting(
        0.15,
        help="distance of the joints at which the edge factorises again",
        unit="rad",
        at_least=0.0,
        may_be_infinite=True,
    )
    refresh_interval_ns: int = setting(
        20_000_000, help="least time between two factorisations", at_least=0
    )
    average_ns: int = setting(
        10_000_000, help="time over which joint positions are averaged, 0: none", at_least=0
    )
    retry_ns: int = setting(
        100_000_000, help="time until the edge sends a factorisation again", at_least=1_000_000
    )
    posture_error: float = setting(
        0.0, help="error of the factorised posture", unit="rad", at_least=0.0
    )
    relaxation: float = setting(1.0, help="part of a correction that is applied", at_least=0.0)
    on_board_budget: float = setting(
        0.0, help="part of the on-board computer's time for factorising", at_least=0.0, at_most=1.0
    )
    refresh_above: float = setting(
        0.5, help="contraction estimate above which the on-board computer factorises", at_least=0.0
    )
    stop_above: float = setting(
        0.8, help="contraction estimate above which a walk ends", at_least=0.0, may_be_infinite=True
    )
    give_up_above: float = setting(
        1.0,
        help="contraction estimate above which no correction is made",
        at_least=0.0,
        may_be_infinite=True,
    )


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
