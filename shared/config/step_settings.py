"""Settings of steps: of a walk `[walk]`, and of decisions by the robot `[stepping]`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from shared.config.quantities import Goal, parse_angle, parse_goal
from shared.config.setting import setting


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
