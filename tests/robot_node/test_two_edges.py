"""Two edges answer one robot: the newest valid answer wins, and either may end at any time."""

from __future__ import annotations

import numpy as np
import pytest

from edge_node.node import EdgeNode
from robot_node.node import RobotNode
from robot_node.tick import Tick
from shared.bus.base import Delivery, Envelope
from shared.telemetry.schema import Source

MS = 1_000_000


class Hot:
    """A robot and two edges; answers take `delays` [ticks], and an edge lives until its end."""

    def __init__(self, robot, motion, config, *, delays, lives):
        self.robot = RobotNode(robot, config, motion, session=5)
        self.edges = [EdgeNode(robot, config, motion) for _ in delays]
        self._tick = Tick(self.robot)
        self._delays, self._lives = delays, lives
        self.commands, self.silences = [], []

    def run(self, ticks):
        on_the_way = []
        for tick in range(ticks):
            state = self._tick.begin(tick * MS)
            for k, edge in enumerate(self.edges):
                if tick < self._lives[k]:
                    edge.receive(state, tick * MS)
                    answer = edge.step()
                    if answer is not None and answer.data is not None:
                        envelope = Envelope(k, tick, 0, 0)
                        on_the_way.append((tick + self._delays[k], Delivery(answer.data, envelope)))
            arrived = [delivery for due, delivery in on_the_way if due == tick]
            command, _ = self._tick.end(tick * MS + MS // 2, arrived)
            self.commands.append(command)
            self.silences.append(tick - self.robot.cache.newest_stamp_ns / MS)
        return self


@pytest.fixture
def hot(robot, motion, configured):
    def build(controller, **how):
        return Hot(robot, motion, configured(controller=controller, push=[]), **how)

    return build


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_the_faster_edge_is_followed_and_its_end_costs_the_difference(hot, controller):
    played = hot(controller, delays=(3, 8), lives=(200, 10**9)).run(400)
    ages = np.array([command.age_ns for command in played.commands]) / MS
    assert (ages[10:200] < 4).all()
    # Its last answer is used until one of the other is newer.
    assert ages[200:].max() < 9
    assert all(command.source is not Source.HELD for command in played.commands[10:])
    by_sender = played.robot.answers.by_sender
    assert by_sender["00000000"]["taken"] > 190
    assert by_sender["00000001"]["taken"] > 190
    # What comes second is stale, and nothing else is refused.
    assert played.robot.cache.refused.keys() <= {"stale"}
    assert not played.robot.fallen


def test_equal_edges_are_interchangeable_to_the_last_bit(hot):
    both = hot("la", delays=(3, 3), lives=(150, 10**9)).run(300)
    one = hot("la", delays=(3,), lives=(10**9,)).run(300)
    for ours, theirs in zip(both.commands, one.commands, strict=True):
        np.testing.assert_array_equal(ours.tau, theirs.tau)
    assert not both.robot.cache.refused


def test_lc_hears_of_either_edge(hot):
    played = hot("lc", delays=(3, 8), lives=(300, 10**9)).run(700)
    # Each gives a sign of life every 0.1 s.
    assert max(played.silences[20:]) < 120
    assert not played.robot.fallen
    taken = [counts["taken"] for counts in played.robot.answers.by_sender.values()]
    assert min(taken) >= 3


def test_a_lying_edge_beside_an_honest_one_changes_nothing(hot, robot, motion, configured):
    honest = hot("la", delays=(3,), lives=(10**9,)).run(200)
    played = hot("la", delays=(0, 3), lives=(10**9, 10**9))
    liar = played.edges[0]
    encode = liar._codec.encode_projector

    def lie(message):
        for timed in message.projectors:
            timed.projector.A_dagger.setflags(write=True)
            timed.projector.A_dagger[:] *= -1.0
        return encode(message)

    liar._codec.encode_projector = lie
    played.run(200)
    # The liar is faster in every tick. Its first answers come when there is no other.
    for ours, theirs in zip(played.commands[3:], honest.commands[3:], strict=True):
        np.testing.assert_array_equal(ours.tau, theirs.tau)
    assert played.robot.cache.refused["dynamics"] >= 196
