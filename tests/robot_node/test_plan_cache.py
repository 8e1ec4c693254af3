"""Plans and step laws at the robot: those that fit are taken, all others change nothing."""

from __future__ import annotations

import dataclasses
import math

import msgpack
import numpy as np
import pytest

from robot_node.plan_cache import PlanCache
from robot_node.sent_states import SentStates
from robot_node.stepping import ContactClock
from shared.motion.ground import make_ground
from shared.motion.planned import Plan, PlannedPhase, PlanOrigin
from shared.motion.stance import Stance
from shared.motion.standing import Standing
from shared.motion.step_law import NoGo, make_step_law
from shared.robots import Foot
from shared.wbc.contacts import ContactMode
from shared.wire.codec import Codec
from shared.wire.messages import PlanMessage
from shared.wire.plans import PlanCodec, as_sent, law_identity

SESSION, STAMP_NS, NOW_NS = 3, 1_000_000, 2_000_000
DOUBLE, LEFT = ContactMode.DOUBLE_SUPPORT, ContactMode.LEFT_SUPPORT


class Bench:
    """A robot that stands and has sent two states; offers answer the first one."""

    def __init__(self, robot, config):
        codec = Codec(robot, config, Standing(robot))
        self.clock = ContactClock(robot, config)
        ground = make_ground(config.ground, seed=config.seed)
        self.cache = PlanCache(codec, robot, self.clock, session=SESSION, ground=ground)
        self.codec = PlanCodec(codec)
        self.sent = SentStates(robot.model.nv - 6)
        v = np.zeros(robot.model.nv)
        for tick in range(2):
            self.sent.add(tick, stamp_ns=STAMP_NS + tick, q=robot.q_standing, v=v)

    def offer(self, content, **identity):
        asked = {"session": SESSION, "sequence": 0, "stamp_ns": STAMP_NS, **identity}
        return self.offer_bytes(self.codec.encode(PlanMessage(**asked, content=content)))

    def offer_bytes(self, data):
        return self.cache.offer(data, sent=self.sent, now_ns=NOW_NS, time_ns=0)


@pytest.fixture
def bench(robot, configured):
    return Bench(robot, configured(**{"stepping.mode": "on", "wbc.balance.law": "dcm"}))


@pytest.fixture
def law(robot):
    return as_sent(make_step_law(robot, Stance.of(robot)))


@pytest.fixture
def plan(bench, robot):
    """One step of the right foot, 20 cm ahead."""
    feet = bench.clock.feet
    left, right = feet[Foot.LEFT], feet[Foot.RIGHT]
    goal = dataclasses.replace(right, x=right.x + 0.2)
    # Backwards from rest: the DCM at the end of each phase.
    rest, cop = np.array((0.1, 0.0)), np.array((0.0, 0.1))
    lifts = cop + (rest - cop) * math.exp(-Stance.of(robot).omega * 0.4)
    return Plan(
        number=0,
        origin=PlanOrigin(SESSION, 0, 0),
        valid_until_ns=NOW_NS + 1,
        feet=(left, right),
        com=(0.03, 0.0),
        phases=(
            PlannedPhase(DOUBLE, 0, 500_000_000, None, (0.0, 0.0), tuple(lifts.tolist())),
            PlannedPhase(LEFT, 500_000_000, 900_000_000, goal, (0.0, 0.1), (0.1, 0.0)),
            PlannedPhase(DOUBLE, 900_000_000, 2_000_000_000, None, (0.1, 0.0), (0.1, 0.0)),
        ),
        swing_height=0.05,
    )


def refusal(bench):
    (reason,) = bench.cache.refused
    return reason


def untouched(bench):
    return bench.clock.plan is None and bench.cache.law == 0


def test_a_plan_for_the_present_phase_is_followed(bench, plan):
    assert bench.offer(plan)
    assert bench.cache.plan == 0
    assert bench.clock.plan is not None
    assert not bench.cache.refused


def test_a_robot_that_was_held_takes_only_plans_from_where_it_stands(bench, plan):
    """A plan that an outage has held back was made for a robot in motion. A new edge begins to
    count anew.
    """
    assert bench.offer(dataclasses.replace(plan, number=0))
    bench.cache.drop(0)
    assert (bench.cache.plan, bench.clock.plan) == (-1, None)
    assert not bench.offer(dataclasses.replace(plan, number=0))
    assert refusal(bench) == "stale"
    newer = dataclasses.replace(plan, origin=PlanOrigin(SESSION, 1, 0))
    assert bench.offer(newer, sequence=1, stamp_ns=STAMP_NS + 1)
    assert bench.cache.plan == 0
    assert bench.clock.plan is not None


def test_a_law_is_held_and_reported(bench, law):
    assert bench.offer(law)
    assert bench.cache.law == law_identity(law)
    assert bench.clock.law is not None


def test_a_robot_without_a_law_of_the_edge_steps_by_its_own(bench, law):
    assert bench.cache.law == 0
    assert law_identity(bench.clock.law) == law_identity(law)


@pytest.mark.parametrize(
    ("identity", "reason"),
    [
        ({"session": 4}, "session"),
        ({"sequence": 2}, "future"),
        ({"stamp_ns": STAMP_NS + 1}, "stamp"),
    ],
)
def test_an_answer_to_a_state_that_was_not_sent_is_refused(bench, plan, identity, reason):
    assert not bench.offer(plan, **identity)
    assert refusal(bench) == reason
    assert untouched(bench)


def moved(plan, **changes):
    """The plan with another footprint."""
    step = plan.phases[1]
    changed = dataclasses.replace(step, footprint=dataclasses.replace(step.footprint, **changes))
    return dataclasses.replace(plan, phases=(plan.phases[0], changed, plan.phases[2]))


def with_phase(plan, at, **changes):
    phases = list(plan.phases)
    phases[at] = dataclasses.replace(phases[at], **changes)
    return dataclasses.replace(plan, phases=tuple(phases))


def lasting(plan, factor):
    """The plan with steps of another duration."""
    step = plan.phases[1]
    end_ns = step.begin_ns + round(factor * (step.end_ns - step.begin_ns))
    return with_phase(plan, 1, end_ns=end_ns)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda plan: dataclasses.replace(plan, origin=PlanOrigin(SESSION, 0, 1)), "phase"),
        (lambda plan: dataclasses.replace(plan, number=-1), "stale"),
        # No edge has made so many plans by now: this one would make all later ones stale.
        (lambda plan: dataclasses.replace(plan, number=1), "number"),
        (lambda plan: dataclasses.replace(plan, number=2**63 - 1), "number"),
        (lambda plan: dataclasses.replace(plan, valid_until_ns=NOW_NS - 1), "expired"),
        (lambda plan: dataclasses.replace(plan, phases=plan.phases[:2]), "shape"),
        (lambda plan: dataclasses.replace(plan, phases=plan.phases[1:]), "phase"),
        (
            lambda plan: dataclasses.replace(plan, phases=(plan.phases[0], *plan.phases)),
            "shape",
        ),
        (
            lambda plan: dataclasses.replace(
                plan, feet=(plan.feet[0], dataclasses.replace(plan.feet[1], x=0.2))
            ),
            "feet",
        ),
        (lambda plan: moved(plan, x=0.6), "reach"),
        (lambda plan: moved(plan, y=0.0), "reach"),
        (lambda plan: moved(plan, y=-0.6), "reach"),
        (lambda plan: moved(plan, yaw=1.0), "reach"),
        (lambda plan: moved(plan, z=0.2), "reach"),
        (lambda plan: dataclasses.replace(plan, swing_height=0.5), "reach"),
        (lambda plan: dataclasses.replace(plan, swing_height=-0.1), "reach"),
        (lambda plan: with_phase(plan, 0, cop=(5.0, 0.0)), "reach"),
        # A DCM that no CoP under the feet brings about.
        (lambda plan: with_phase(plan, 1, cop=(0.0, 0.13)), "course"),
        (lambda plan: with_phase(plan, 1, dcm=(0.4, 0.0)), "course"),
        (lambda plan: with_phase(plan, 2, dcm=(0.13, 0.0)), "course"),
        (lambda plan: lasting(plan, 0.5), "course"),
        (lambda plan: lasting(plan, 100.0), "course"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused_with_the_reason(bench, plan, change, reason):
    assert not bench.offer(change(plan))
    assert refusal(bench) == reason
    assert untouched(bench)


def test_only_a_newer_plan_replaces_another(bench, plan):
    assert bench.offer(plan)
    assert not bench.offer(plan)
    assert bench.cache.refused == {"stale": 1}
    second = dataclasses.replace(plan, number=1, origin=PlanOrigin(SESSION, 1, 0))
    assert bench.offer(second, sequence=1, stamp_ns=STAMP_NS + 1)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda law: {"footholds_x": 2.0 * law.footholds_x}, "reach"),
        (lambda law: {"footholds_x": 0.1 * law.footholds_x}, "reach"),
        (lambda law: {"footholds_y": law.footholds_y - 0.1}, "reach"),
        (lambda law: {"cops_x": law.cops_x + 0.05}, "reach"),
        (lambda law: {"omega": 2.0 * law.omega}, "reach"),
        (lambda law: {"width": 0.5}, "reach"),
        (lambda law: {"times": law.times + 5.0}, "reach"),
        (lambda law: {"values_x": -law.values_x}, "values"),
        (lambda law: {"values_y": 0.0 * law.values_y}, "values"),
        # The best foothold would be the worst.
        (lambda law: {"values_x": law.values_x[::-1].copy()}, "values"),
        (lambda law: {"values_y": law.values_y.max() - law.values_y}, "values"),
        (lambda law: {"going_on_y": law.going_on_y + 1e6}, "values"),
        (lambda law: {"values_x": 1.01 * law.values_x}, "values"),
        # Every foothold would be forbidden, and no step found under a push.
        (lambda law: {"no_go": (NoGo((-9.0, 9.0), (-9.0, 9.0)),)}, "reach"),
        (lambda law: {"cop_nominal": law.cop_nominal + 1e6}, "reach"),
        # The ends of the grid stay.
        (lambda law: {"footholds_x": law.footholds_x**3 / law.footholds_x[-1] ** 2}, "reach"),
    ],
)
def test_a_law_that_is_not_the_robots_own_is_refused(bench, law, change, reason):
    assert not bench.offer(dataclasses.replace(law, **change(law)))
    assert refusal(bench) == reason
    assert untouched(bench)


def test_a_law_for_the_ground_that_both_ends_know_is_taken(robot, configured):
    config = configured(
        **{
            "task": "go",
            "wire.projector_dtype": "float32",
            "stepping.mode": "on",
            "wbc.balance.law": "dcm",
            "ground": "stairs:3x6cm",
        }
    )
    bench = Bench(robot, config)
    ground = make_ground("stairs:3x6cm", seed=config.seed)
    assert bench.offer(as_sent(make_step_law(robot, bench.clock.stance, ground)))
    assert not bench.offer(as_sent(make_step_law(robot, bench.clock.stance)))


def test_no_mutation_of_a_plan_takes_a_foot_out_of_reach(bench, plan, law):
    """3000 plans and laws with bytes changed, from a seed. Whatever is taken obeys the bounds."""
    rng = np.random.default_rng(9)
    originals = [
        bench.codec.encode(PlanMessage(SESSION, 0, STAMP_NS, content)) for content in (plan, law)
    ]
    taken = 0
    for k in range(3000):
        data = bytearray(originals[k % 2])
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        taken += bench.offer_bytes(bytes(data))
    assert sum(bench.cache.refused.values()) == 3000 - taken
    followed = bench.clock.plan
    if followed is not None:
        goal, support = followed.phases[1].footprint, followed.feet[0]
        assert abs(goal.x - support.x) <= 0.37
        assert 0.12 <= support.y - goal.y <= 0.5
    held = bench.clock.law
    if held is not None:
        assert np.isfinite(held.values_x).all()
        assert abs(held.footholds_x).max() <= 0.361


def test_an_old_schema_is_refused_by_its_name(bench, plan):
    fields = msgpack.unpackb(bench.codec.encode(PlanMessage(SESSION, 0, STAMP_NS, plan)))
    assert not bench.offer_bytes(msgpack.packb({**fields, "version": 2}))
    assert refusal(bench) == "version"
