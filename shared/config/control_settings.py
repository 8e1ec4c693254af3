"""Settings of the controller: the QP `[wbc]`, contact switches `[switch]`, LC `[correction]`."""

from __future__ import annotations

from dataclasses import dataclass, field

from shared.config.setting import setting

CORRECTION_LEVELS = ("b", "b_adjoint", "c")


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
