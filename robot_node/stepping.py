"""Steps by touch: the robot decides when its feet lift and land, and by the step law where.

A contact clock counts the phases of the contact mode. A phase on one foot ends when the measured
force shows that the swing foot is loaded. A foot that lands early is loaded at once, and one that
lands late goes on down. A phase on both feet ends by the plan's time, or when the divergent
component of motion (DCM) is about to leave the support. Then the robot steps as the step law says.
Without a plan it stands.

The rungs of its ladder: the step law with a fresh DCM; without a law, the plan's own footprints and
times; at the end of a plan, the stand on the feet where they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shared.config.settings import RunConfig
from shared.motion.footprint import Footprint
from shared.motion.footsteps import standing_footprints
from shared.motion.pendulum import dcm_of, moved_dcm
from shared.motion.planned import SUPPORT_MODE, Plan, PlannedPhase, other
from shared.motion.stance import middle
from shared.motion.standing import Standing
from shared.motion.step_decision import Balance, InAir, StepDecision
from shared.motion.step_law import StepLaw
from shared.motion.swing import SwingPath
from shared.robots import Foot, Robot
from shared.wbc.contacts import ContactMode
from shared.wbc.model import Kinematics
from shared.wbc.reference import Reference, turned

# Weight of a tick in the average of a loaded sole's place: joint positions have noise.
_AVERAGE = 0.03
# After a landing the DCM goes to its rest with this time constant [s].
_SETTLING = 0.6
# Part of a swing before which a force on the foot is that of lifting off.
_MAY_LAND = 0.5
# A sole that is higher above its goal [m], or less level (the cosine of its tilt), has hit an edge
# and has not landed.
_HIGHEST, _LEVEL = 0.08, 0.92
# A foot that has just landed does not step again within this time [s]; the other one may.
_SAME_FOOT = 0.25
# The longest wait of a planned step [s] for a DCM that is further than this from its planned place
# [m].
_WAITS, _NEAR = 0.3, 0.02
# The longest step of time in which the CoM follows its references [s]. After ticks without a
# measurement more has passed.
_LONGEST = 0.05
# Rate at which the height of the CoM follows that of the feet [1/s].
_LEVELLING = 6.0


@dataclass(slots=True)
class _Swing:
    """A swing foot: its path, and the CoP that the law asks for."""

    foot: Foot
    begin: float
    path: SwingPath
    nominal: Footprint | None
    nominal_time: float | None
    cop: np.ndarray | None


@dataclass(slots=True)
class Measured:
    """The measurements that the clock needs in a tick.

    `kinematics` is that of the measured state, `disturbance` (2,) the external force as a shift of
    the CoP [m], `forces` (3,) those on the soles [N].
    """

    kinematics: Kinematics
    disturbance: np.ndarray
    forces: dict[Foot, np.ndarray]


class ContactClock:
    """The phases of the contact mode, by time and by touch, and the reference in each.

    `phase` is the number of the present phase, and `phase_ns` the time since it began. `ground` is
    the one that robot and edge know.
    """

    def __init__(self, robot: Robot, config: RunConfig) -> None:
        self.phase = 0
        self.phase_ns = 0
        self.law: StepLaw | None = None
        self.plan: Plan | None = None
        self._config = config.stepping
        self._decision = StepDecision(robot, config)
        self.stance, self.ground = self._decision.stance, self._decision.ground
        self._omega = self.stance.omega
        self._standing = Standing(robot).reference(0)
        self.feet = standing_footprints(robot)
        self._ticks_loaded = dict.fromkeys(Foot, 1000)
        self._swing: _Swing | None = None
        self._begin = self._last_time = 0.0
        self._last_landed: Foot | None = None
        self._offset = np.zeros(2)
        self._com: np.ndarray | None = None
        # Height of the CoM above that of standing, and its rate.
        self._level = self._level_rate = 0.0
        self._next_ns = 0
        # The place of the present phase in the plan.
        self._at = 0

    @property
    def mode(self) -> ContactMode:
        """The present contact mode."""
        return ContactMode.DOUBLE_SUPPORT if self._swing is None else SUPPORT_MODE[self._swing.foot]

    @property
    def swing_path(self) -> SwingPath | None:
        """The path of the swing foot; None on both feet."""
        return None if self._swing is None else self._swing.path

    @property
    def chosen(self) -> Footprint | None:
        """The foothold that the law has chosen for the swing foot; None without one."""
        swing = self._swing
        return None if swing is None or swing.cop is None else swing.path.goal

    @property
    def place(self) -> int:
        """The number of the present phase in the plan; it counts on after the plan's last phase."""
        return self._at

    def frozen(self, time_ns: int) -> bool:
        """Return whether the swing foot is so near its landing that its goal is fixed."""
        swing = self._swing
        return swing is not None and swing.path.end - time_ns * 1e-9 < self._config.freeze

    def take(self, plan: Plan) -> None:
        """Follow a plan from now on. Its first phase is the present one."""
        self.plan, self._at = plan, 0
        swing, goal = self._swing, plan.phases[0].footprint
        if swing is None or goal is None:
            return
        duration = (plan.phases[0].end_ns - plan.phases[0].begin_ns) * 1e-9
        swing.nominal, swing.nominal_time = goal, duration
        if self.law is None:
            # Not within the time in which the goal of the foot is fixed.
            end = max(swing.begin + duration, self._last_time + self._config.freeze)
            swing.path = swing.path.retargeted(goal, time=self._last_time, end=end)

    def reference(self, measured: Measured, *, time_ns: int, decides: bool = True) -> Reference:
        """Advance the clock to a time of the task. Return the reference then.

        Unless it `decides`, no foot lifts, and the goal of a swing foot stays. It still lands by
        touch.
        """
        now, time = measured.kinematics, time_ns * 1e-9
        self._observe(now)
        dcm = dcm_of(now.com[:2], now.com_velocity[:2], omega=self._omega)
        if self._swing is not None and self._touches(now, measured.forces, time):
            self._land(dcm, time)
        if decides and time_ns >= self._next_ns:
            self._next_ns = time_ns + self._config.period_ns
            balance = Balance(self.feet, dcm, measured.disturbance)
            if self._swing is not None:
                self._retarget(balance, time)
            elif time - self._begin >= self._config.double_support or self.phase == 0:
                self._lift_off(balance, time)
        self.phase_ns = round((time - self._begin) * 1e9)
        return self._reference(now, dcm, time)

    def _observe(self, now: Kinematics) -> None:
        """Average the places of the loaded soles."""
        for foot, print_ in self.feet.items():
            if self._swing is not None and foot is self._swing.foot:
                continue
            placement = now.sole_placement(foot)
            x, y, z = placement.translation.tolist()
            R = placement.rotation
            turn = math.remainder(math.atan2(R[1, 0], R[0, 0]) - print_.yaw, math.tau)
            self._ticks_loaded[foot] += 1
            share = max(1.0 / self._ticks_loaded[foot], _AVERAGE)
            self.feet[foot] = Footprint(
                foot,
                print_.x + share * (x - print_.x),
                print_.y + share * (y - print_.y),
                print_.yaw + share * turn,
                print_.z + share * (z - print_.z),
            )

    def _touches(self, now: Kinematics, forces: dict[Foot, np.ndarray], time: float) -> bool:
        swing = self._swing
        assert swing is not None
        may_land = time - swing.begin >= _MAY_LAND * (swing.path.end - swing.begin)
        # A force that is NaN is no touch.
        if not (may_land and forces[swing.foot][2] >= self._config.landing_force):
            return False
        placement = now.sole_placement(swing.foot)
        above = float(placement.translation[2]) - swing.path.goal.z
        return above <= _HIGHEST and bool(placement.rotation[2, 2] >= _LEVEL)

    def _land(self, dcm: np.ndarray, time: float) -> None:
        swing = self._swing
        assert swing is not None
        self.feet[swing.foot] = swing.path.goal
        self._ticks_loaded[swing.foot] = 0
        self._last_landed, self._swing = swing.foot, None
        self._enter_phase(time)
        self._offset = dcm - self.stance.rest_over(self.feet)

    def _enter_phase(self, time: float) -> None:
        self.phase += 1
        self._begin = time
        self._at += 1

    @property
    def _planned(self) -> PlannedPhase | None:
        """The present phase of the plan; None in a stand."""
        if self.plan is None or self._at >= len(self.plan.phases):
            return None
        return self.plan.phases[self._at]

    @property
    def _next_planned(self) -> PlannedPhase | None:
        if self.plan is None or self._at + 1 >= len(self.plan.phases):
            return None
        return self.plan.phases[self._at + 1]

    def _retarget(self, balance: Balance, time: float) -> None:
        swing = self._swing
        assert swing is not None
        if self.law is None or swing.path.end - time < self._config.freeze:
            return
        state = swing.path.state(time)
        motion = np.array((state.position[:2], state.velocity[:2], state.acceleration[:2]))
        in_air = InAir(
            swing.foot,
            motion,
            time - swing.begin,
            swing.nominal,
            swing.nominal_time,
            self.chosen,
        )
        step = self._decision.step(self.law, balance, in_air)
        if step is not None:
            swing.cop = step.cop
            end = time + step.remaining
            swing.path = swing.path.retargeted(step.footprint, time=time, end=end)

    def _lift_off(self, balance: Balance, time: float) -> None:
        """Lift a foot if the plan says so now, or if the robot has to step."""
        phase, following = self._planned, self._next_planned
        if phase is not None and following is not None and following.footprint is not None:
            late = time - self._begin - (phase.end_ns - phase.begin_ns) * 1e-9
            waits = late < _WAITS and self._short_of(phase, following.footprint.foot, balance)
            if late >= 0.0 and not waits:
                duration = (following.end_ns - following.begin_ns) * 1e-9
                self._lift_as_planned(following.footprint, duration, balance, time)
            return
        if self.law is None or not self._decision.must_step(balance):
            return
        stays = self._last_landed if time < self._begin + _SAME_FOOT else None
        step = self._decision.best_step(self.law, balance, without=stays)
        if step is not None:
            self.plan = None
            self._start_swing(step.footprint, time, time + step.remaining, cop=step.cop)

    def _short_of(self, phase: PlannedPhase, lifting: Foot, balance: Balance) -> bool:
        """Return whether the DCM still has to come nearer to the next support foot."""
        way = self.feet[other(lifting)].position - self.feet[lifting].position
        left = way.dot(np.array(phase.dcm) - balance.dcm)
        return bool(left > _NEAR * math.hypot(*way.tolist()))

    def _lift_as_planned(
        self, goal: Footprint, duration: float, balance: Balance, time: float
    ) -> None:
        step = None
        if self.law is not None:
            start = InAir.at_rest(self.feet[goal.foot], goal, duration)
            step = self._decision.step(self.law, balance, start)
        nominal = (goal, duration)
        if step is None:
            self._start_swing(goal, time, time + duration, nominal=nominal)
        else:
            self._start_swing(
                step.footprint, time, time + step.remaining, cop=step.cop, nominal=nominal
            )

    def _start_swing(
        self,
        goal: Footprint,
        time: float,
        end: float,
        *,
        cop: np.ndarray | None = None,
        nominal: tuple[Footprint, float] | None = None,
    ) -> None:
        start, height = self.feet[goal.foot], self._config.swing_height
        if nominal is not None and self.plan is not None:
            height = self.plan.swing_height
        path = SwingPath.between(start, goal, begin=time, end=end, height=height)
        planned, duration = (None, None) if nominal is None else nominal
        self._swing = _Swing(goal.foot, time, path, planned, duration, cop)
        self._enter_phase(time)

    def _reference(self, now: Kinematics, dcm: np.ndarray, time: float) -> Reference:
        standing, swing = self._standing, self._swing
        state, command, mode = None, None, ContactMode.DOUBLE_SUPPORT
        _, _, yaw = middle(self.feet)
        if swing is not None:
            state = swing.path.state(time)
            mode = SUPPORT_MODE[swing.foot]
            support = self.feet[other(swing.foot)]
            yaw = support.yaw + 0.5 * math.remainder(state.yaw - support.yaw, math.tau)
        if swing is not None and swing.cop is not None:
            dcm_ref, cop = dcm, swing.cop
            command = self._omega**2 * (now.com[:2] - cop)
        else:
            dcm_ref, cop = self._planned_dcm(time)
        # The CoM follows its DCM.
        if self._com is None or (swing is not None and swing.cop is not None):
            self._com = np.array(now.com[:2])
        elapsed, self._last_time = min(time - self._last_time, _LONGEST), time
        self._com += elapsed * self._omega * (dcm_ref - self._com)
        com, velocity, acceleration = np.zeros((3, 3))
        com[:2] = self._com
        velocity[:2] = self._omega * (dcm_ref - self._com)
        acceleration[:2] = self._omega**2 * (self._com - cop)
        # The CoM follows its DCM, and is half of the way there after 0.2 s.
        acceleration[2] = self._follow_level((now.com[:2] + dcm) / 2, elapsed)
        com[2], velocity[2] = standing.com[2] + self._level, self._level_rate
        return Reference(
            com=com,
            com_velocity=velocity,
            com_acceleration=acceleration,
            world_from_base=turned(yaw) @ standing.world_from_base,
            posture=standing.posture,
            mode=mode,
            swing=state,
            com_command=command,
        )

    def _follow_level(self, com: np.ndarray, elapsed: float) -> float:
        """Let the CoM follow its height over the feet, at a place (2,) that it comes to. Return its
        vertical acceleration.

        That is the mean height of the feet, in which a swing foot counts with its goal. In a plan
        `walk.com_lowering` keeps the knees bent. After a step of no plan the reach of the legs
        does.
        """
        feet, swing = self.feet, self._swing
        planned = self._planned is not None
        if swing is not None:
            feet = feet | {swing.foot: swing.path.goal}
            planned = swing.nominal is not None
        level = sum(each.z for each in feet.values()) / 2 - self.stance.lowering
        if not planned:
            level = min(level, self.stance.level_within_reach(feet, com))
        rate = _LEVELLING**2 * (level - self._level) - 2.0 * _LEVELLING * self._level_rate
        self._level_rate += elapsed * rate
        self._level += elapsed * self._level_rate
        return rate

    def _planned_dcm(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """The DCM and the CoP of the plan, or of the stand, at a time."""
        phase = self._planned
        since = time - self._begin
        if phase is not None and self._next_planned is not None:
            left = min(0.0, since - (phase.end_ns - phase.begin_ns) * 1e-9)
            cop = np.array(phase.cop)
            growth = math.exp(self._omega * left)
            return moved_dcm(np.array(phase.dcm), cop=cop, growth=growth), cop
        offset = self._offset * math.exp(-since / _SETTLING)
        dcm: np.ndarray = self.stance.rest_over(self.feet) + offset
        return dcm, dcm + offset / (self._omega * _SETTLING)
