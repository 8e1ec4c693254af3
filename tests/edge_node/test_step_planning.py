"""Step laws and plans from the edge: sent until the robot has them, and projectors for any step."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from edge_node.node import EdgeNode
from edge_node.step_planning import StepDelivery, StepPlanning
from shared.motion.footsteps import standing_footprints
from shared.motion.ground import make_ground
from shared.motion.planned import Plan
from shared.motion.standing import Standing
from shared.motion.step_law import StepLaw, ground_edges
from shared.robots import Foot
from shared.wbc.contacts import ContactMode
from shared.wire.codec import Codec
from shared.wire.messages import RobotState, StepReport

MS = 1_000_000
RETRY_NS = 100 * MS
DOUBLE = ContactMode.DOUBLE_SUPPORT


@pytest.fixture(scope="module")
def walk(configured):
    return configured(
        **{
            "task": "walk",
            "wire.projector_dtype": "float32",
            "stepping.mode": "on",
            "wbc.balance.law": "dcm",
            "wbc.weights.com": 10.0,
        }
    )


@pytest.fixture(scope="module")
def planning(robot, walk):
    return StepPlanning(robot, walk)


class Robot:
    """A robot that reports what it has, every millisecond."""

    def __init__(self, robot, planning, model):
        self._robot, self._planning, self._model = robot, planning, model
        self._delivery = StepDelivery(RETRY_NS)
        self.law, self.plan, self.phase = 0, -1, 0
        self.now_ns = 0

    def state(self):
        feet = standing_footprints(self._robot)
        report = StepReport(
            phase=self.phase,
            phase_ns=0,
            plan=self.plan,
            law=self.law,
            feet=(feet[Foot.LEFT], feet[Foot.RIGHT]),
            swing=None,
            disturbance=np.zeros(2),
        )
        q, v = self._robot.q_standing, np.zeros(self._robot.model.nv)
        return RobotState(1, self.now_ns // MS, self.now_ns, 0, DOUBLE, q, v, steps=report)

    def run(self, ms):
        """What the edge sends in a time, with when."""
        sent = []
        for _ in range(ms):
            content = self._delivery.due(self.state(), self._planning, self._model)
            if content is not None:
                sent.append((self.now_ns // MS, content))
            self.now_ns += MS
        return sent


@pytest.fixture
def client(robot, planning, model):
    return Robot(robot, planning, model)


def test_the_law_is_sent_until_the_robot_has_it(client, planning):
    client.plan = 10**9
    laws = [at for at, content in client.run(250) if isinstance(content, StepLaw)]
    assert laws == [0, 100, 200]
    client.law = planning.law_identity
    assert not [each for each in client.run(300) if isinstance(each[1], StepLaw)]


def test_a_plan_is_sent_once_for_each_phase_and_again_if_it_is_lost(client, planning):
    client.law = planning.law_identity
    ((_, first),) = client.run(90)
    assert isinstance(first, Plan)
    assert first.number == 0
    ((at, again),) = client.run(90)
    assert (at, again.number) == (100, 1)
    client.plan = again.number
    assert client.run(400) == []
    client.phase = 2
    ((_, following),) = client.run(60)
    assert following.origin.phase == 2
    assert following.number == 2


def test_a_false_number_of_the_robots_plan_does_not_go_into_later_plans(client, planning):
    client.law = planning.law_identity
    client.run(90)
    client.plan, client.phase = 2**62, 1
    client.run(20)
    client.plan, client.phase = 0, 2
    # A robot refuses a plan with a number above that of the state that it answers.
    later = client.run(400)
    assert later
    assert all(plan.number <= at for at, plan in later)


def test_no_more_than_fifty_messages_a_second(client):
    assert len(client.run(1000)) <= 50


@pytest.mark.parametrize("mode", list(ContactMode))
@pytest.mark.parametrize("every", [1, 2])
def test_la_gets_projectors_of_all_modes_for_a_step_that_nobody_has_planned(
    robot, configured, walk, mode, every
):
    """Beside that of its own mode: one of the two other modes in turn, also if the edge answers
    every second state, and in the numbers of limits, which are single.
    """
    limits = {"wbc.limits.torque": True, "stepping.mode": "on", "wbc.balance.law": "dcm"}
    config = walk if every == 1 else configured(**limits)
    edge = EdgeNode(robot, config, Standing(robot))
    codec = Codec(robot, config, Standing(robot))
    feet = standing_footprints(robot)
    report = StepReport(0, 0, -1, 0, (feet[Foot.LEFT], feet[Foot.RIGHT]), None, np.zeros(2))
    v = np.zeros(robot.model.nv)
    found = []
    for k in range(0, 4 * every, every):
        state = RobotState(
            1, k, k, 0, mode, robot.q_standing, v, com_command=np.zeros(2), steps=report
        )
        edge.receive(codec.encode_state(state), k)
        answer = edge.step()
        assert answer is not None
        assert answer.data is not None
        message = codec.decode_projector(answer.data)
        own, other = (each.projector.mode for each in message.projectors)
        assert own is mode
        found.append(other)
    others = [each for each in ContactMode if each is not mode]
    assert found in (2 * others, 2 * others[::-1])


def test_a_state_keeps_its_report_on_the_wire(robot, walk):
    codec = Codec(robot, walk, Standing(robot))
    feet = standing_footprints(robot)
    report = StepReport(
        7, 12 * MS, 3, 99, (feet[Foot.LEFT], feet[Foot.RIGHT]), None, np.array([0.25, -0.5])
    )
    v = np.zeros(robot.model.nv)
    state = RobotState(
        1, 2, 3, 4, DOUBLE, robot.q_standing, v, (1, 2, 3), np.array([0.5, 0.0]), report
    )
    received = codec.decode_state(codec.encode_state(state)).steps
    for name in ("phase", "phase_ns", "plan", "law", "swing"):
        assert getattr(received, name) == getattr(report, name)
    assert received.disturbance == pytest.approx(report.disturbance)
    assert received.feet[1].y == pytest.approx(feet[Foot.RIGHT].y, abs=1e-7)
    air = dataclasses.replace(state, mode=ContactMode.LEFT_SUPPORT)
    assert codec.decode_state(codec.encode_state(air)).steps.swing is not None


def test_a_sole_may_not_be_set_on_an_edge_or_in_a_hole(robot):
    """Romeo's sole reaches 12 cm ahead and 7.35 cm back; stairs begin 0.2 m ahead, a gap 0.35 m."""
    first = ground_edges(robot, make_ground("stairs:3x6cm", seed=0))[0]
    assert first.x == pytest.approx((0.2 - 0.12, 0.2 + 0.0735))
    boxes = ground_edges(robot, make_ground("gap:10cm", seed=0))
    (gap,) = (box for box in boxes if box.x[1] - box.x[0] > 0.25)
    assert gap.x == pytest.approx((0.35 - 0.12, 0.45 + 0.0735))
    assert ground_edges(robot, make_ground("flat", seed=0)) == ()
