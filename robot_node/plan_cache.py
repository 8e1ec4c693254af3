"""The newest plan and step law of the edge, and why the others were refused.

Both are taken only if they fit this robot. The feet of a plan must be where the robot's feet are,
and its footprints within the reach of the legs. The CoPs of a plan must move its DCM as those of a
pendulum do, from phase to phase to a rest. A plan must also be for the robot's present phase and
newer than the last one, and no swing foot may be about to land. A law has no choice of the edge: it
must be the robot's own for the ground that both ends know. So a plan that is late, false or from
another edge changes nothing.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from robot_node.sent_states import SentStates
from robot_node.stepping import ContactClock
from shared.bus.base import RefusalCounter
from shared.errors import MessageRefused
from shared.motion.footprint import Footprint
from shared.motion.footsteps import MAX_TURN
from shared.motion.ground import Ground
from shared.motion.pendulum import moved_dcm
from shared.motion.planned import Plan, other
from shared.motion.step_law import StepLaw, make_step_law
from shared.robots import Foot, Robot
from shared.wbc.contacts import ContactMode
from shared.wire.codec import Codec
from shared.wire.messages import PlanMessage
from shared.wire.plans import PlanCodec, as_sent, law_identity

# The largest distance of a plan's feet from the robot's [m, rad].
_FEET_APART, _FEET_TURNED = 0.05, 0.2
# The largest difference of a law's numbers from the robot's own, as a part of the largest one.
_ROUNDING = 1e-4
# The largest climb or descent of a foot from the other one, and its largest height above both [m].
_CLIMB, _LIFT = 0.15, 0.3
# The largest distance of a plan's CoPs and DCMs from a foot [m].
_FARTHEST = 1.0
# The largest distance of the DCM at the beginning of a phase from that at the end of the one before
# [m].
_JUMP = 0.01
# The arrays of a law that do not count as its reach.
_VALUES = ("values_x", "values_y", "going_on_x", "going_on_y")


class PlanCache:
    """Take in the messages on the key of plans, and give plans and laws to the contact clock."""

    def __init__(
        self,
        codec: Codec,
        robot: Robot,
        clock: ContactClock,
        *,
        session: int,
        ground: Ground,
        whole_plans: bool = True,
    ) -> None:
        """Begin without a plan and with the robot's own law, for the `ground` that both ends know.

        The planner on the edge alone sends parts of plans: only `whole_plans` lead to a rest.
        """
        self.refused = RefusalCounter()
        self.law = 0
        self.plan = -1
        self._dropped_at = -1
        self._codec = PlanCodec(codec)
        self._clock = clock
        self._session = session
        self._whole_plans = whole_plans
        self._own = as_sent(make_step_law(robot, clock.stance, ground))
        if whole_plans:
            # An edge that is silent, or that sends false laws, does not keep the robot from a step.
            clock.law = self._own

    def drop(self, sequence: int) -> None:
        """Forget the plan, and refuse later all plans by the states up to `sequence`.

        The edge learns that the robot has no plan, and makes one from where the robot stands.
        """
        self._clock.plan, self.plan, self._dropped_at = None, -1, sequence

    def offer(self, data: bytes, *, sent: SentStates, now_ns: int, time_ns: int) -> bool:
        """Take a received message if it is valid. Return whether it was taken.

        `now_ns` is the robot's clock, `time_ns` the time of its task.
        """
        try:
            message = self._codec.decode(data)
            self._check_echo(message, sent)
            if isinstance(message.content, StepLaw):
                self._take_law(message.content)
            else:
                self._take_plan(message.content, now_ns=now_ns, time_ns=time_ns)
        except MessageRefused as refusal:
            self.refused[refusal.reason] += 1
            return False
        return True

    def _check_echo(self, message: PlanMessage, sent: SentStates) -> None:
        if message.session != self._session:
            raise MessageRefused("session", "answers another start of the robot")
        if message.sequence > sent.newest:
            raise MessageRefused("future", f"{message.sequence}")
        stamp_ns = sent.stamp_ns(message.sequence)
        if stamp_ns is None:
            raise MessageRefused("stale", f"{message.sequence}, which is forgotten")
        if message.stamp_ns != stamp_ns:
            raise MessageRefused("stamp", f"{message.stamp_ns}, sent {stamp_ns}")

    def _take_law(self, law: StepLaw) -> None:
        numbers = _numbers(law)
        for name, ours in _numbers(self._own).items():
            theirs = numbers[name]
            if theirs.shape != ours.shape or not np.allclose(
                theirs, ours, rtol=0.0, atol=_ROUNDING * np.abs(ours).max(initial=1.0)
            ):
                raise MessageRefused("values" if name in _VALUES else "reach", name)
        self._clock.law, self.law = law, law_identity(law)

    def _take_plan(self, plan: Plan, *, now_ns: int, time_ns: int) -> None:
        clock = self._clock
        if plan.origin.phase != clock.phase:
            raise MessageRefused("phase", f"{plan.origin.phase}, the robot is in {clock.phase}")
        if plan.number <= self.plan:
            raise MessageRefused("stale", f"plan {plan.number} after {self.plan}")
        if plan.origin.sequence <= self._dropped_at:
            raise MessageRefused("stale", f"plan {plan.number}, of before the end of a joint hold")
        # An edge makes at most one plan by a state, so an honest number is not above the states'.
        # A huge one would make all later plans stale.
        if plan.number > plan.origin.sequence:
            raise MessageRefused("number", f"plan {plan.number} by state {plan.origin.sequence}")
        if now_ns > plan.valid_until_ns:
            raise MessageRefused("expired", f"plan {plan.number}")
        if clock.frozen(time_ns):
            raise MessageRefused("frozen", f"plan {plan.number}, as the foot is about to land")
        self._check_modes(plan)
        self._check_places(plan)
        if self._whole_plans:
            self._check_course(plan)
        clock.take(plan)
        self.plan = plan.number

    def _check_modes(self, plan: Plan) -> None:
        modes = [phase.mode for phase in plan.phases]
        if modes[0] is not self._clock.mode:
            raise MessageRefused("phase", f"{modes[0].name}, the robot is in another mode")
        if modes[-1] is not ContactMode.DOUBLE_SUPPORT:
            raise MessageRefused("shape", "a plan that does not end in a stand")
        both = [mode is ContactMode.DOUBLE_SUPPORT for mode in modes]
        if any(first == second for first, second in itertools.pairwise(both)):
            raise MessageRefused("shape", "phases that do not alternate")

    def _check_places(self, plan: Plan) -> None:
        feet = {each.foot: each for each in plan.feet}
        for foot, own in self._clock.feet.items():
            theirs = feet[foot]
            apart = math.dist((own.x, own.y, own.z), (theirs.x, theirs.y, theirs.z))
            turned = abs(math.remainder(own.yaw - theirs.yaw, math.tau))
            if apart > _FEET_APART or turned > _FEET_TURNED:
                raise MessageRefused("feet", f"the {foot.value} foot {apart:.3f} m from its place")
        if not 0.0 <= plan.swing_height <= _LIFT:
            raise MessageRefused("reach", f"a foot {plan.swing_height:.3f} m high")
        for phase in plan.phases:
            if phase.footprint is not None:
                self._check_reach(phase.footprint, feet[other(phase.footprint.foot)])
                feet[phase.footprint.foot] = phase.footprint
            for point in (phase.cop, phase.dcm):
                if min(math.dist(point, (each.x, each.y)) for each in feet.values()) > _FARTHEST:
                    raise MessageRefused("reach", "a CoP or a DCM far from the feet")

    def _check_course(self, plan: Plan) -> None:
        """Check that the CoPs of a plan move its DCM ξ from phase to phase, and to a rest.

        The first phase continues the robot's motion and is not checked.
        """
        for before, phase in itertools.pairwise(plan.phases):
            decay = math.exp(-self._own.omega * (phase.end_ns - phase.begin_ns) * 1e-9)
            start = moved_dcm(np.array(phase.dcm), cop=np.array(phase.cop), growth=decay)
            jump = math.dist(start, before.dcm)
            if jump > _JUMP:
                raise MessageRefused("course", f"a DCM that jumps by {jump:.3f} m")
        rest = plan.phases[-1]
        if math.dist(rest.cop, rest.dcm) > _JUMP:
            raise MessageRefused("course", "a stand in which the DCM moves")

    def _check_reach(self, goal: Footprint, support: Footprint) -> None:
        own = self._own
        c, s = math.cos(support.yaw), math.sin(support.yaw)
        dx, dy = goal.x - support.x, goal.y - support.y
        side = 1.0 if goal.foot is Foot.LEFT else -1.0
        x, y = c * dx + s * dy, side * (-s * dx + c * dy)
        turn = abs(math.remainder(goal.yaw - support.yaw, math.tau))
        if not (
            own.footholds_x[0] - _ROUNDING <= x <= own.footholds_x[-1] + _ROUNDING
            and own.footholds_y[0] - _ROUNDING <= y <= own.footholds_y[-1] + _ROUNDING
            and turn <= MAX_TURN
            and abs(goal.z - support.z) <= _CLIMB
        ):
            place = f"({x:.3f}, {y:.3f}, {goal.z - support.z:.3f}) m"
            raise MessageRefused("reach", f"a footprint at {place}, {turn:.2f} rad")


def _numbers(law: StepLaw) -> dict[str, np.ndarray]:
    """Return all numbers of a law, by the names of its fields."""
    boxes = np.array([[*box.x, *box.y] for box in law.no_go])
    return {**{name: np.asarray(value) for name, value in vars(law).items()}, "no_go": boxes}
