"""The step law: no step from rest, footholds beyond the DCM, within reach, mirrored."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from shared.motion.stance import Stance
from shared.motion.step_law import NoGo, StepQuestion, choose_step, make_step_law


@pytest.fixture(scope="module")
def law(robot):
    return make_step_law(robot, Stance.of(robot))


def question(law, dcm, **others):
    """A question at lift-off, with the swing foot beside the support foot."""
    swing = np.zeros((3, 2))
    swing[0] = 0.0, law.width
    asked = StepQuestion(
        dcm=np.array(dcm),
        disturbance=np.zeros(2),
        swing=swing,
        elapsed=0.0,
        nominal=np.array([0.0, law.width]),
    )
    return dataclasses.replace(asked, **others)


def ask(law, asked):
    return choose_step(law, asked, least=0.05, held=0.03)


def test_the_pendulum_lands_where_the_law_says(law):
    """ξ_T = p + (ξ − p) e^{ωT} + δ (e^{ωh} − 1) e^{ω(T−h)}, by integration of ξ̇ = ω (ξ − p + δ)."""
    force = np.array([0.2, -0.05])
    answer = ask(law, question(law, (0.1, 0.08), disturbance=force))
    dcm, dt = np.array([0.1, 0.08]), 1e-5
    for k in range(round(answer.remaining / dt)):
        pushed = force if k * dt < 0.03 else 0.0
        dcm = dcm + dt * law.omega * (dcm - answer.cop + pushed)
    assert answer.dcm_at_end == pytest.approx(dcm, abs=1e-4)


@pytest.mark.parametrize("x", [-0.15, -0.12, 0.15, 0.2])
def test_a_foot_lands_so_that_it_captures_the_dcm(law, x):
    """With the DCM ahead the foot lands ahead, and the DCM lies over its sole."""
    answer = ask(law, question(law, (x, law.width / 2)))
    assert math.copysign(1.0, answer.foothold[0]) == math.copysign(1.0, x)
    offset = answer.dcm_at_end[0] - answer.foothold[0]
    assert law.cops_x[0] - 0.06 < offset < law.cops_x[-1] + 0.06
    farther = ask(law, question(law, (1.2 * x, law.width / 2)))
    assert abs(farther.foothold[0]) > abs(answer.foothold[0])


def test_from_rest_the_foot_comes_down_beside_the_other_one(law):
    at_rest = np.array([law.cop_nominal[0], law.width / 2])
    answer = ask(law, question(law, at_rest))
    assert answer.foothold == pytest.approx([0.0, law.width], abs=0.03)


@pytest.mark.parametrize("dcm", [(0.3, 0.3), (-0.3, 0.0), (0.0, -0.2), (0.5, 0.5), (2.0, -2.0)])
def test_no_foothold_is_out_of_reach(law, dcm):
    """Nor does the swing foot need more than its greatest acceleration, 30 m/s²."""
    asked = question(law, dcm)
    answer = ask(law, asked)
    assert law.footholds_x[0] <= answer.foothold[0] <= law.footholds_x[-1]
    assert law.footholds_y[0] <= answer.foothold[1] <= law.footholds_y[-1]
    distance = np.abs(answer.foothold - asked.swing[0]).max()
    # Of a quintic from rest to rest; half a step of the grid for the refinement.
    step = law.footholds_x[1] - law.footholds_x[0]
    assert 5.7735 * (distance - step / 2) / answer.remaining**2 <= 30.0 * 1.01


def test_late_in_a_swing_the_foot_lands_near_its_way(law):
    """60 ms before the latest landing the foot cannot go far any more."""
    swing = np.zeros((3, 2))
    swing[0] = 0.1, law.width
    answer = ask(law, question(law, (0.6, 0.1), swing=swing, elapsed=law.times[-1] - 0.06))
    assert abs(answer.foothold[0] - 0.1) < 0.05


def test_there_is_no_answer_when_no_landing_time_is_left(law):
    assert ask(law, question(law, (0.1, 0.1), elapsed=law.times[-1] - 0.04)) is None


def test_no_foot_lands_in_a_forbidden_box(law):
    free = ask(law, question(law, (0.2, law.width / 2)))
    x, y = free.foothold
    box = NoGo((x - 0.06, x + 0.06), (y - 0.3, y + 0.3))
    barred = dataclasses.replace(law, no_go=(box,))
    to_world = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    answer = ask(barred, question(law, (0.2, law.width / 2), to_world=to_world))
    assert not box.x[0] < answer.foothold[0] < box.x[1]
    assert answer.cost > free.cost


def slow_step(law, y, **others):
    """A question in a step of 0.77 s in place, with the DCM at y."""
    step = {"nominal_time": 0.77, "goes_on": True, **others}
    return question(law, (law.cop_nominal[0], y), **step)


@pytest.mark.parametrize("elapsed", [0.0, 0.08, 0.3])
def test_a_slow_undisturbed_step_lands_in_its_place(law, elapsed):
    """Between two CoPs of the law's grid the DCM at the landing differs by 0.2 m."""
    begin = law.width / (1.0 + math.exp(law.omega * 0.77))
    answer = ask(law, slow_step(law, begin * math.exp(law.omega * elapsed), elapsed=elapsed))
    assert answer.foothold == pytest.approx([0.0, law.width], abs=0.02)


def test_of_two_equally_good_footholds_the_last_one_stays(law):
    """Half a millimetre of the DCM decides between footholds that are 3 cm apart."""
    asked, moved = (slow_step(law, y, elapsed=0.1) for y in (0.0119, 0.0124))
    first, other = ask(law, asked), ask(law, moved)
    assert abs(first.foothold[1] - other.foothold[1]) > 0.03
    stays = ask(law, dataclasses.replace(moved, last=first.foothold))
    assert stays.foothold == pytest.approx(first.foothold, abs=0.01)


def test_decisions_lead_from_a_bad_foothold_to_a_good_one(law):
    asked = slow_step(law, 0.0119, elapsed=0.1)
    last = np.array([0.2, law.footholds_y[-1]])
    for _ in range(10):
        last = ask(law, dataclasses.replace(asked, last=last)).foothold
    assert last == pytest.approx(ask(law, asked).foothold, abs=0.02)


def test_the_tables_are_those_of_both_feet(robot):
    """The law is in the frame of either support foot, so a mirrored robot has the same tables."""
    left, right = robot.soles
    flipped = [
        dataclasses.replace(sole, side=side, y=(-sole.y[1], -sole.y[0]))
        for sole, side in ((right, left.side), (left, right.side))
    ]
    mirrored = dataclasses.replace(robot, soles=tuple(flipped))
    stance = Stance.of(robot)
    one, two = make_step_law(robot, stance), make_step_law(mirrored, stance)
    assert one.values_y == pytest.approx(two.values_y, abs=1e-12)
    assert one.cops_y == pytest.approx(two.cops_y, abs=1e-12)


def test_a_captured_dcm_costs_little_and_one_that_is_lost_much(law):
    middle = (law.cops_x[0] + law.cops_x[-1]) / 2
    values = np.interp([middle, middle + 0.1, middle + 0.3], law.offsets, law.values_x)
    assert values[0] < 0.01
    assert values[0] < values[1] < values[2]
    assert (law.going_on_x >= law.values_x - 1e-12).all()
