"""When the edge factorises for a robot that corrects: what it lacks, and what it has left."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_node.refresh import FactorisationRefresh
from shared.config.control_settings import CorrectionConfig
from shared.wbc.contacts import ContactMode
from tests.messages import make_state

MS = 1_000_000
DOUBLE, LEFT, RIGHT = ContactMode
EVERY_MODE = (DOUBLE, LEFT, RIGHT)
CONFIG = CorrectionConfig(refresh_distance=0.1, refresh_interval_ns=0, retry_ns=100 * MS)


class Plan:
    """A motion that only knows its contact modes: {from [ms]: mode}."""

    digest = bytes(8)

    def __init__(self, modes):
        self.modes = {time * MS: mode for time, mode in modes.items()}

    def next_switch(self, time_ns):
        return next((time for time in self.modes if time > time_ns), None)

    def reference(self, time_ns):
        began = max(time for time in self.modes if time <= time_ns)
        return SimpleNamespace(mode=self.modes[began])


STANDING = Plan({0: DOUBLE})
WALK = Plan({0: DOUBLE, 300: LEFT, 600: DOUBLE, 620: RIGHT})


class Bench:
    """A robot whose state the test sets, and which holds what has arrived."""

    def __init__(self, robot, motion, config):
        self.refresh = FactorisationRefresh(config, motion)
        self.motion = motion
        self.q = robot.q_standing.copy()
        self.held_sequences = [-1, -1, -1]
        self._robot = robot

    def due(self, tick):
        return self.refresh.due(self.state(tick), tuple(self.held_sequences), posture=self.q[7:])

    def state(self, tick):
        # The robot's clock began long before.
        return make_state(
            self._robot,
            sequence=tick,
            stamp_ns=(5_000 + tick) * MS,
            time_ns=tick * MS,
            mode=self.motion.reference(tick * MS).mode,
            q=self.q,
            held_sequences=tuple(self.held_sequences),
        )

    def serve(self, tick, *, arrives=True):
        """What is due is computed, sent and, unless it is lost, held."""
        due = self.due(tick)
        if due is not None:
            self.refresh.sent(self.state(tick), due, posture=self.q[7:])
            if arrives:
                for mode in due:
                    self.held_sequences[mode] = tick
        return due

    def modes(self, tick):
        """The modes due; whether or not an answer without any is, too."""
        return self.due(tick) or ()

    def move(self, distance):
        """Every joint, one this way and the next one that."""
        self.q = self.q.copy()
        self.q[7:] += distance * np.resize([1.0, -1.0], len(self.q) - 7)


@pytest.fixture
def bench(robot):
    def build(motion=STANDING, **changes):
        return Bench(robot, motion, dataclasses.replace(CONFIG, **changes))

    return build


def test_at_first_every_mode_is_due(bench):
    for motion in (STANDING, WALK):
        assert bench(motion).due(0) == EVERY_MODE


def test_what_was_not_sent_is_due_again(bench):
    # It may have been singular at that state.
    asked = bench()
    assert asked.due(0) == EVERY_MODE
    assert asked.due(1) == EVERY_MODE
    asked.refresh.sent(asked.state(1), (LEFT,), posture=asked.q[7:])
    assert asked.due(2) == (DOUBLE, RIGHT)


def test_nothing_is_due_while_what_was_sent_has_arrived_and_the_robot_stays_near(bench):
    served = bench(WALK)
    served.serve(0)
    served.move(0.0999)
    assert [served.modes(tick) for tick in range(1, 1000)] == [()] * 999


def test_nothing_is_due_while_an_answer_is_under_way(bench):
    served = bench()
    served.serve(0, arrives=False)
    assert [served.due(tick) for tick in range(1, 100)] == [None] * 99


def test_when_there_is_nothing_to_send_a_sign_of_life_is_due_every_retry_period(bench):
    served = bench()
    answers = {tick: served.serve(tick) for tick in range(450)}
    given = {tick: due for tick, due in answers.items() if due is not None}
    assert given == {0: EVERY_MODE, 100: (), 200: (), 300: (), 400: ()}


def test_an_answer_with_something_in_it_is_a_sign_of_life(bench):
    served = bench()
    served.serve(0)
    served.move(0.2)
    assert served.serve(60) == (DOUBLE,)
    assert [served.serve(tick) for tick in range(61, 160)] == [None] * 99
    assert served.serve(160) == ()


def test_a_sign_of_life_is_not_taken_for_a_factorisation(bench):
    served = bench()
    served.serve(0)
    served.move(0.08)
    assert served.serve(100) == ()
    # The distance still counts from tick 0.
    served.move(0.08)
    assert served.serve(101) == (DOUBLE,)


def test_what_does_not_arrive_is_sent_again_after_the_retry_period(bench):
    served = bench()
    served.serve(7, arrives=False)
    assert served.due(106) is None
    assert served.serve(107) == EVERY_MODE
    assert [served.modes(tick) for tick in range(108, 1000, 50)] == [()] * 18


def test_each_time_it_waits_twice_as_long_up_to_sixteen_times(bench):
    served = bench()
    sent = [tick for tick in range(6000) if served.serve(tick, arrives=False)]
    assert np.diff(sent).tolist() == [100, 200, 400, 800, 1600, 1600]


def test_after_an_arrival_it_waits_as_short_as_at_first(bench):
    served = bench()
    for tick in range(300):
        served.serve(tick, arrives=False)
    assert served.serve(300) == EVERY_MODE
    served.serve(301)
    served.move(0.2)
    assert served.serve(310, arrives=False) == (DOUBLE,)
    assert served.modes(409) == ()
    assert served.modes(410) == (DOUBLE,)


def test_it_waits_longer_than_the_last_answer_took_to_arrive(bench):
    served = bench()
    assert served.serve(0, arrives=False) == EVERY_MODE
    assert served.serve(100, arrives=False) == EVERY_MODE
    # The first one has taken 250 ms; of the second nothing is known yet.
    served.held_sequences = [0, 0, 0]
    assert served.modes(250) == ()
    # It takes 260 ms.
    served.held_sequences = [100, 100, 100]
    assert served.modes(360) == ()
    served.move(0.2)
    assert served.serve(400, arrives=False) == (DOUBLE,)
    again = next(tick for tick in range(401, 2000) if served.modes(tick))
    assert 400 + 260 < again < 400 + 2 * 260


def test_the_modes_that_did_arrive_are_not_sent_again(bench):
    served = bench()
    served.serve(7, arrives=False)
    served.held_sequences[LEFT] = 7
    assert served.due(20) is None
    assert served.due(107) == (DOUBLE, RIGHT)


def test_an_older_factorisation_does_not_stand_for_the_one_that_was_lost(bench):
    served = bench()
    served.serve(0)
    served.move(0.2)
    assert served.serve(10, arrives=False) == (DOUBLE,)
    assert served.held_sequences == [0, 0, 0]
    assert served.due(109) is None
    assert served.due(110) == (DOUBLE,)


def test_a_newer_one_than_was_sent_stands_for_it(bench):
    # The robot may have computed one itself.
    served = bench()
    served.serve(0, arrives=False)
    served.held_sequences = [40, 40, 40]
    assert served.modes(500) == ()


def test_the_retry_period_is_that_of_the_settings(bench):
    served = bench(retry_ns=3 * MS)
    served.serve(0, arrives=False)
    assert [served.due(tick) for tick in range(1, 5)] == [None, None, EVERY_MODE, EVERY_MODE]


def test_a_moving_robot_is_served_once_per_interval(bench):
    served = bench(refresh_interval_ns=20 * MS)
    served.serve(0)
    given = []
    for tick in range(1, 100):
        served.move(0.2 if tick % 2 else -0.5)
        if served.serve(tick):
            given.append(tick)
    assert given == [20, 40, 60, 80]


def test_what_was_lost_does_not_wait_for_the_interval(bench):
    served = bench(refresh_interval_ns=500 * MS)
    served.serve(0, arrives=False)
    assert served.serve(100) == EVERY_MODE


@pytest.mark.parametrize("sign", [1, -1])
def test_a_posture_left_far_behind_makes_the_present_and_the_next_mode_due(bench, sign):
    served = bench(WALK)
    served.serve(0)
    served.move(sign * 0.1001)
    assert served.due(1) == (DOUBLE, LEFT)
    assert served.due(299) == (DOUBLE, LEFT)
    assert served.due(300) == (DOUBLE, LEFT)
    assert served.due(601) == (DOUBLE, RIGHT)
    # After the last switch there is no next mode.
    assert served.due(700) == (RIGHT,)


@pytest.mark.parametrize(("part", "due"), [(0.999, None), (-0.999, None), (1.001, (DOUBLE,))])
@pytest.mark.parametrize("joint", [0, 17, 30])
def test_the_distance_is_the_root_of_the_mean_square_of_all_joints(bench, joint, part, due):
    served = bench()
    served.serve(0)
    served.q = served.q.copy()
    served.q[7 + joint] += part * 0.1 * math.sqrt(len(served.q) - 7)
    assert served.due(1) == due


def test_a_standing_robot_needs_its_only_mode(bench):
    served = bench()
    served.serve(0)
    served.move(1.0)
    assert served.due(1) == (DOUBLE,)


def test_distance_counts_from_where_each_mode_was_factorised(bench):
    served = bench(WALK)
    served.serve(0)
    served.move(0.08)
    assert served.serve(1) is None
    served.move(0.08)
    assert served.serve(2) == (DOUBLE, LEFT)
    assert served.due(3) is None
    # The right foot's is the first one still.
    assert served.modes(601) == (RIGHT,)
    served.move(-0.09)
    assert served.modes(601) == ()


def test_where_the_base_is_does_not_matter(bench):
    served = bench()
    served.serve(0)
    served.q = served.q.copy()
    served.q[:7] = [4.0, -3.0, 0.5, 1.0, 0.0, 0.0, 0.0]
    assert served.due(1) is None


def test_a_robot_that_has_moved_far_is_not_sent_the_same_twice_while_it_waits(bench):
    served = bench()
    served.serve(0)
    served.move(0.2)
    assert served.serve(1, arrives=False) == (DOUBLE,)
    assert served.due(2) is None
    # It goes on moving: what is under way is of no use any more.
    served.move(0.2)
    assert served.due(3) == (DOUBLE,)


def test_the_posture_is_remembered_and_not_the_array_it_came_in(bench):
    served = bench()
    served.serve(0)
    served.q[7:] += 0.2
    assert served.due(1) == (DOUBLE,)


def test_an_infinite_distance_means_never(bench):
    served = bench(WALK, refresh_distance=float("inf"))
    served.serve(0)
    served.move(1e6)
    assert [served.modes(tick) for tick in (1, 300, 601)] == [()] * 3


def test_a_robot_that_never_reports_an_arrival_is_served_for_ever(bench):
    served = bench()
    # Two doublings of a number per try would overflow it after a thousand.
    sent = [served.serve(100 * k, arrives=False) for k in range(20_000)]
    assert sum(modes == EVERY_MODE for modes in sent) > 1100


def test_an_edge_that_started_anew_sends_to_a_robot_that_holds_something(bench):
    served = bench()
    served.held_sequences = [4, 4, 4]
    assert served.due(900) == EVERY_MODE


def test_a_robot_that_holds_nothing_any_more_is_served_again(bench):
    # Its controller was replaced, or a state that was wrong has said that all had arrived.
    served = bench()
    served.serve(0)
    assert served.serve(1) is None
    served.held_sequences = [-1, -1, -1]
    assert served.serve(101) == EVERY_MODE
    assert served.due(102) is None
