"""A walk as a reference: footsteps, CoM plan, swing foot and contact modes put together.

begin on both feet | single support, double support | … | end on both feet. Both ends of the link
build it from the same configuration, whose digest every message carries.
"""

from __future__ import annotations

import bisect
import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from shared.config.step_settings import WalkConfig
from shared.motion.com_plan import ComPlan, ZmpSegment, dcm_plan
from shared.motion.cross_fade import CrossFade
from shared.motion.footprint import Footprint
from shared.motion.footsteps import Step, plan_footsteps
from shared.motion.mpc_plan import SupportPhase, mpc_plan
from shared.motion.standing import Standing
from shared.motion.swing import quintic, swing
from shared.robots import GRAVITY, Foot, Robot
from shared.wbc.contacts import ContactMode
from shared.wbc.reference import Motion, Reference, motion_digest, turned

# Time in which the ZMP goes from the last support foot to between the feet [s].
_SETTLE = 0.4
_SUPPORT_MODE = {Foot.LEFT: ContactMode.LEFT_SUPPORT, Foot.RIGHT: ContactMode.RIGHT_SUPPORT}


@dataclass(frozen=True)
class Phase:
    """A span of one contact mode; `step` is the step under way, or the last one."""

    begin_ns: int
    end_ns: int
    mode: ContactMode
    step: Step | None


class Walking:
    """Reference motion of a walk. `ConfigError` if the steps cannot be walked.

    `steps` are those of `config`, unless others are given.
    """

    def __init__(
        self, robot: Robot, config: WalkConfig, *, steps: tuple[Step, ...] | None = None
    ) -> None:
        self._given_steps = steps is not None
        self.steps = plan_footsteps(robot, config) if steps is None else steps
        self._robot = robot
        self._config = config
        standing = Standing(robot).reference(0)
        self._standing = standing
        self._com_height = float(standing.com[2]) - config.com_lowering
        self._zmp_in_sole = {sole.side: (sum(sole.x) / 2, 0.0) for sole in robot.soles}
        self._base_in_standing = standing.world_from_base
        self.phases = _phases(config, self.steps)
        self._ends = [phase.end_ns for phase in self.phases]
        self.support_phases = self._support_phases(robot)
        self.com_plan = self._plan_com(standing.com[:2])
        self.digest = self._digest()

    def reference(self, time_ns: int) -> Reference:
        """Reference at `time_ns` since the walk began; standing after its end."""
        phase = self._phase(time_ns)
        com, com_velocity, com_acceleration = self.com_plan.motion(time_ns * 1e-9)
        swing_state, yaw = None, self._yaw_after(phase)
        if phase.mode is not ContactMode.DOUBLE_SUPPORT and phase.step is not None:
            elapsed = (time_ns - phase.begin_ns) * 1e-9
            duration = (phase.end_ns - phase.begin_ns) * 1e-9
            swing_state = swing(
                phase.step.start,
                phase.step.goal,
                time=elapsed,
                duration=duration,
                height=self._config.swing_height + phase.step.obstacle,
            )
            before = (phase.step.start.yaw + phase.step.support.yaw) / 2
            yaw = before + quintic(elapsed / duration)[0] * (yaw - before)
        return Reference(
            com=com,
            com_velocity=com_velocity,
            com_acceleration=com_acceleration,
            world_from_base=turned(yaw).dot(self._base_in_standing),
            posture=self._standing.posture,
            mode=phase.mode,
            swing=swing_state,
        )

    @property
    def duration(self) -> float:
        """The duration from standing to standing [s]."""
        return self.phases[-1].end_ns * 1e-9

    def next_switch(self, time_ns: int) -> int | None:
        k = bisect.bisect_right(self._ends, time_ns)
        return self.phases[k].end_ns if k + 1 < len(self.phases) else None

    def stopped(self, time_ns: int) -> Motion:
        """Return the motion that finishes the step under way, and one more that brings the feet
        together.
        """
        under_way = sum(phase.end_ns <= time_ns for phase in self.phases[1::2])
        steps = under_way + 2
        if steps >= len(self.steps):
            return self
        # In closed form for both plans, because it is needed within a few ticks.
        config = dataclasses.replace(self._config, steps=steps, com_plan="dcm")
        first = self.steps[:steps] if self._given_steps else None
        shorter = Walking(self._robot, config, steps=first)
        return CrossFade(self, shorter, begin_ns=time_ns)

    def _phase(self, time_ns: int) -> Phase:
        k = bisect.bisect_right(self._ends, max(0, time_ns))
        return self.phases[min(k, len(self.phases) - 1)]

    @staticmethod
    def _yaw_after(phase: Phase) -> float:
        if phase.step is None:
            return 0.0
        return (phase.step.goal.yaw + phase.step.support.yaw) / 2

    def _digest(self) -> bytes:
        """Digest of the footprints, of the phases' ends and modes, and of the CoM every 50 ms."""
        goals = [[each.x, each.y, each.yaw, each.z] for each in (step.goal for step in self.steps)]
        ends = [[phase.end_ns * 1e-9, phase.mode] for phase in self.phases]
        times = np.arange(0.0, self.duration, 0.05)
        com = [self.com_plan.motion(time)[0] for time in times]
        return motion_digest(np.array(goals), np.array(ends), np.array(com))

    def _support_phases(self, robot: Robot) -> list[SupportPhase]:
        """Loaded soles in time, with the ZMP under the support foot, at last between the feet."""
        soles = {sole.side: sole.corners()[:, :2] for sole in robot.soles}
        phases = []

        def add(
            begin: float,
            end: float,
            prints: tuple[Footprint, ...],
            zmp: np.ndarray,
            v: np.ndarray,
            ground: float,
        ) -> None:
            corners = [each.to_world(corner) for each in prints for corner in soles[each.foot]]
            phases.append(SupportPhase(begin, end, np.array(corners), zmp, v, ground))

        still = np.zeros(2)
        for phase in self.phases:
            begin, end, step = phase.begin_ns * 1e-9, phase.end_ns * 1e-9, phase.step
            if step is None:
                first = self.steps[0]
                support = first.support
                add(begin, end, (support, first.start), self._zmp(support), still, support.z)
                continue
            moved = self._zmp(step.goal) - self._zmp(step.start)
            velocity = moved / 2 / self._config.step_duration
            if phase.mode is not ContactMode.DOUBLE_SUPPORT:
                support = step.support
                add(begin, end, (support,), self._zmp(support), velocity, support.z)
            elif phase is not self.phases[-1]:
                # The foot that has just landed is the support foot of the next step.
                goal = step.goal
                add(begin, end, (step.support, goal), self._zmp(goal), velocity, goal.z)
            else:
                centre = (self._zmp(step.support) + self._zmp(step.goal)) / 2
                # At the end the CoM is as high as in standing.
                between = (step.support.z + step.goal.z) / 2 + self._config.com_lowering
                for span in ((begin, begin + _SETTLE), (begin + _SETTLE, end)):
                    add(*span, (step.support, step.goal), centre, still, between)
        return phases

    def _plan_com(self, start: np.ndarray) -> ComPlan:
        omega = math.sqrt(GRAVITY / self._com_height)
        phases = self.support_phases
        if self._config.com_plan == "mpc":
            return mpc_plan(phases, omega=omega, position=start)
        ends = [np.append(phase.zmp, phase.ground) for phase in phases]
        segments = [
            ZmpSegment(phase.begin, phase.finish, begin, end)
            for phase, begin, end in zip(phases, [ends[0], *ends], ends, strict=False)
        ]
        position = np.append(start, self._config.com_lowering)
        return dcm_plan(segments, omega=omega, position=position)

    def _zmp(self, print_: Footprint) -> np.ndarray:
        return print_.to_world(self._zmp_in_sole[print_.foot])


def _phases(config: WalkConfig, steps: tuple[Step, ...]) -> tuple[Phase, ...]:
    time_ns = round(config.begin_duration * 1e9)
    phases = [Phase(0, time_ns, ContactMode.DOUBLE_SUPPORT, None)]
    double_ns = round(config.double_support * 1e9)
    single_ns = round(config.step_duration * 1e9) - double_ns
    for step in steps:
        landing_ns = time_ns + single_ns
        phases.append(Phase(time_ns, landing_ns, _SUPPORT_MODE[step.support.foot], step))
        time_ns = landing_ns + double_ns
        phases.append(Phase(landing_ns, time_ns, ContactMode.DOUBLE_SUPPORT, step))
    end_ns = time_ns + round(config.end_duration * 1e9)
    phases[-1] = Phase(phases[-1].begin_ns, end_ns, ContactMode.DOUBLE_SUPPORT, steps[-1])
    return tuple(phases)
