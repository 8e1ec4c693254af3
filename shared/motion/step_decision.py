"""Decisions on steps: whether the robot must step, with which foot, and where.

The robot decides from its newest state. With `stepping.mode = "edge"` the edge decides, from the
newest state that has arrived.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shared.config.settings import RunConfig
from shared.motion.footprint import Footprint
from shared.motion.ground import make_ground
from shared.motion.pendulum import moved_dcm
from shared.motion.planned import other
from shared.motion.stance import Stance, lower_foot, middle
from shared.motion.step_law import StepLaw, StepQuestion, choose_step
from shared.robots import Foot, Robot
from shared.wbc.balance import convex_hull, within
from shared.wbc.reference import turned


@dataclass(frozen=True, slots=True)
class Balance:
    """The state that a decision rests on, in the plan's frame.

    It has the soles, and the DCM and the external force as a shift of the CoP, (2,) each [m].
    """

    feet: Mapping[Foot, Footprint]
    dcm: np.ndarray
    disturbance: np.ndarray


@dataclass(frozen=True, slots=True)
class InAir:
    """A step under way or about to begin.

    `motion` (3, 2) has the position, velocity and acceleration of the swing foot's reference in the
    plane. `elapsed` is the time since lift-off. `nominal` and `nominal_time` are the foothold and
    time of an undisturbed step, None if no plan asks for a step. `chosen` is the foothold that the
    law has chosen last, None without one.
    """

    foot: Foot
    motion: np.ndarray
    elapsed: float = 0.0
    nominal: Footprint | None = None
    nominal_time: float | None = None
    chosen: Footprint | None = None

    @staticmethod
    def at_rest(
        print_: Footprint, nominal: Footprint | None = None, nominal_time: float | None = None
    ) -> InAir:
        """The step of a foot that is still on the ground."""
        motion = np.zeros((3, 2))
        motion[0] = print_.position
        return InAir(print_.foot, motion, 0.0, nominal, nominal_time)


@dataclass(frozen=True, slots=True)
class Step:
    """A decision: the footprint, the time until the landing [s], the CoP until then and the DCM at
    the landing (2,), the price J.
    """

    footprint: Footprint
    remaining: float
    cop: np.ndarray
    dcm: np.ndarray
    cost: float


class StepDecision:
    """Decides on the steps of one robot, on the `ground` that it knows."""

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self.stance = Stance.of(robot, lowering=config.walk.com_lowering)
        self._config = config.stepping
        self._gain = config.wbc.balance.gain
        self.ground = make_ground(config.ground, seed=config.seed)
        self._corners = {sole.side: sole.corners() for sole in robot.soles}

    def must_step(self, balance: Balance) -> bool:
        """Return whether the DCM leaves the support soon, also under the best CoP."""
        corners = np.array(
            [
                print_.to_world((x, y))
                for foot, print_ in balance.feet.items()
                for x, y, _ in self._corners[foot].tolist()
            ]
        )
        dcm, disturbance, omega = balance.dcm, balance.disturbance, self.stance.omega
        rest = self.stance.rest_over(balance.feet)
        wanted = rest + (1.0 + self._gain / omega) * (dcm - rest) + disturbance
        cop = np.array(within(convex_hull(corners), (wanted[0], wanted[1]), beyond=0.0))
        growth = math.exp(omega * self._config.ahead)
        ahead = moved_dcm(dcm, cop=cop, growth=growth) + (growth - 1.0) * disturbance
        _, _, yaw = middle(balance.feet)
        aside = self._config.beyond_sideways * turned(yaw)[:2, 1]
        larger = convex_hull(np.concatenate((corners + aside, corners - aside)))
        return within(larger, (ahead[0], ahead[1]), beyond=0.0) != (ahead[0], ahead[1])

    def step(self, law: StepLaw, balance: Balance, in_air: InAir) -> Step | None:
        """Return the best step of a foot by the law, or None if none is within reach."""
        support = balance.feet[other(in_air.foot)]
        c, s = math.cos(support.yaw), math.sin(support.yaw)
        side = 1.0 if in_air.foot is Foot.LEFT else -1.0
        # Axes of the support sole as rows, y to the other foot.
        axes = np.array(((c, s), (-side * s, side * c)))
        origin = support.position
        goal, yaw, level = np.array((0.0, law.width)), support.yaw, lower_foot(balance.feet)
        if in_air.nominal is not None:
            goal = axes @ (in_air.nominal.position - origin)
            yaw, level = in_air.nominal.yaw, in_air.nominal
        # A step after a push follows the DCM at once. A planned one stays where it is as good.
        last = None
        if in_air.nominal is not None and in_air.chosen is not None:
            last = axes @ (in_air.chosen.position - origin)
        motion = in_air.motion @ axes.T
        motion[0] -= axes @ origin
        choice = choose_step(
            law,
            StepQuestion(
                dcm=axes @ (balance.dcm - origin),
                disturbance=axes @ balance.disturbance,
                swing=motion,
                elapsed=in_air.elapsed,
                nominal=goal,
                nominal_time=in_air.nominal_time,
                goes_on=in_air.nominal is not None,
                to_world=np.column_stack((axes.T, origin)),
                last=last,
            ),
            least=self._config.freeze,
            held=self._config.force_lasts,
        )
        if choice is None:
            return None
        x, y = (origin + choice.foothold @ axes).tolist()
        sole = Footprint(in_air.foot, x, y, yaw, level.z)
        return Step(
            dataclasses.replace(sole, z=level.z + self._climb(level, sole)),
            choice.remaining,
            origin + choice.cop @ axes,
            origin + choice.dcm_at_end @ axes,
            choice.cost,
        )

    def _climb(self, begin: Footprint, sole: Footprint) -> float:
        """Height of the known ground under a level sole, from that in the middle of another one
        [m].

        Downhill the heel comes first, and the sole lands as high as the ground under it. Uphill the
        toe comes first, and an early landing is safe.
        """
        if self.ground.flat:
            return 0.0
        corners = self._corners[sole.foot]
        heel = corners[corners[:, 0] == corners[:, 0].min(), :2]
        points = [(sole.x, sole.y), *(sole.to_world((x, y)) for x, y in heel.tolist())]
        under = float(self.ground.heights(np.array(points)).max())
        return under - self.ground.height(begin.x, begin.y)

    def best_step(
        self, law: StepLaw, balance: Balance, *, without: Foot | None = None
    ) -> Step | None:
        """Return the best step of either foot, except the foot `without`."""
        steps = [
            self.step(law, balance, InAir.at_rest(balance.feet[foot]))
            for foot in Foot
            if foot is not without
        ]
        found = [step for step in steps if step is not None]
        return min(found, key=lambda step: step.cost) if found else None
