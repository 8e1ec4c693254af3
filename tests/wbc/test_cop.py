"""The task of the centre of pressure in the QP, at both ends of the link."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shared.robots import Foot
from shared.wbc.projector import solve
from shared.wbc.qp import DaqpSolver
from shared.wbc.stack import Stack
from shared.wbc.tasks import CopTask
from tests.states import State
from tests.wbc.correction_bench import LEVELS, MODES, TOLERANCE, Bench, relative

# A place on the feet that is not below the CoM [m].
SHIFT = np.array([0.03, -0.02, 0.0])


@pytest.fixture(params=MODES, ids=lambda mode: mode.name)
def pressing(request, robot, configured, model, reference):
    return Bench(stack_with(robot, configured, request.param, 1.0), model, reference)


def stack_with(robot, configured, mode, weight):
    return Stack(robot, configured(**{"wbc.weights.cop": weight}).wbc, mode)


def cop_of(bench, state, y):
    """The centre of pressure of the forces of a solution, (3,) in the world."""
    now, _ = bench.linearised(state, y)
    force, moment = np.zeros((2, 3))
    for foot, wrench in bench.stack.contacts.wrenches(y[bench.model.nv :]).items():
        sole = now.sole_placement(foot)
        of_foot = sole.rotation @ wrench[:3]
        force += of_foot
        moment += np.cross(sole.translation, of_foot) + sole.rotation @ wrench[3:]
    height = now.sole_placement(bench.stack.support_foot).translation[2]
    # p × F = moment in the plane, with p at the height of the sole.
    x = (height * force[0] - moment[1]) / force[2]
    y_ = (height * force[1] + moment[0]) / force[2]
    return np.array([x, y_, height])


def shifted(reference, shift):
    return dataclasses.replace(reference, com=reference.com + shift)


def test_without_a_weight_there_is_no_row(stacks):
    for stack in stacks.values():
        assert "cop" not in dict(stack.layout.blocks)


def test_a_row_is_the_distance_of_the_cop_from_its_reference(robot, model, configured, reference):
    """With forces that carry the accelerations, in the units of a pendulum: ω² [m/s² per m]."""
    for mode in MODES:
        bench = Bench(stack_with(robot, configured, mode, 4.0), model, reference)
        q, v = standing_in_motion(robot)
        state = State(q, v)
        y = bench.optimum(state).x
        now, residual = bench.linearised(state, y)
        rise = now.com_acceleration[2] + 9.81
        height = now.com[2] - now.sole_placement(bench.stack.support_foot).translation[2]
        # The CoM of the reference rests: its CoP is below it.
        away = cop_of(bench, state, y) - now.com
        wanted = reference.com - now.com
        expected = (rise * away - 9.81 * wanted)[:2] / height
        rows = residual[bench.stack.layout.slice("cop")]
        np.testing.assert_allclose(rows, 2.0 * expected, atol=1e-6)


def standing_in_motion(robot):
    """A robot with level soles, whose base and arms move."""
    q, v = robot.q_standing.copy(), np.zeros(37)
    q[0] += 0.01
    v[:6] = [0.1, -0.05, 0.02, 0.0, 0.0, 0.0]
    for name in ("LShoulderPitch", "RElbowRoll", "TrunkYaw"):
        v[robot.model.joints[robot.model.getJointId(name)].idx_v] = 1.5
    return q, v


@pytest.mark.parametrize("level", LEVELS)
def test_one_correction_with_a_fresh_factorisation_is_the_optimum(pressing, pairs, level):
    for state, _ in pairs[:4]:
        expected = pressing.optimum(state).x
        iterate = pressing.converged(pressing.factorise(state.q), state, level=level, steps=1)
        assert relative(iterate.y - expected, expected) < TOLERANCE


def test_a_projector_of_before_takes_the_cop_to_a_new_reference(pressing, states):
    """LA: the reference is in b alone."""
    for state in states[:6]:
        b = pressing.stack.right_hand_side(pressing.model.kinematics(*state), pressing.reference)
        solution = solve(pressing.stack, pressing.matrices(state.q), b, solver=DaqpSolver())
        moved = Bench(pressing.stack, pressing.model, shifted(pressing.reference, 0.1 * SHIFT))
        expected = moved.optimum(state)
        if not np.array_equal(expected.active, solution.projector.active):
            continue
        b = moved.stack.right_hand_side(moved.model.kinematics(*state), moved.reference)
        assert relative(solution.projector.apply(b) - expected.x, expected.x) < TOLERANCE


def test_a_larger_weight_brings_the_cop_closer_to_its_reference(
    robot, configured, model, reference
):
    state = State(robot.q_standing, np.zeros(37))
    feet = model.sole_placements(state.q)
    for mode in MODES:
        middle = np.mean([feet[foot].translation for foot in mode.feet], axis=0)
        wanted = shifted(reference, [*(middle - reference.com + SHIFT)[:2], 0.0])
        distances = []
        for weight in (1e-6, 1.0, 1e2, 1e5):
            bench = Bench(stack_with(robot, configured, mode, weight), model, wanted)
            cop = cop_of(bench, state, bench.optimum(state).x)
            distances.append(np.linalg.norm((cop - wanted.com)[:2]))
        assert distances == sorted(distances, reverse=True)
        assert distances[-1] < 1e-3 < 0.02 < distances[0]


def test_a_law_commands_the_cop(robot, configured, model, reference):
    state = State(robot.q_standing, np.zeros(37))
    bench = Bench(
        stack_with(robot, configured, MODES[0], 1e5),
        model,
        dataclasses.replace(reference, com_command=np.array([0.4, -0.2])),
    )
    cop = cop_of(bench, state, bench.optimum(state).x)
    com = model.kinematics(*state).com
    height = com[2] - cop[2]
    np.testing.assert_allclose(cop[:2], com[:2] - height / 9.81 * np.array([0.4, -0.2]), atol=1e-3)


def test_a_fallen_robot_gets_finite_rows(model, robot, reference):
    task = CopTask(weight=1.0, mass=robot.mass, foot=Foot.LEFT)
    q = robot.q_standing.copy()
    q[3:7] = [1.0, 0.0, 0.0, 0.0]  # upside down
    rows = np.full(2, np.nan)
    task.write_target(rows, model.kinematics(q, np.zeros(37)), reference)
    assert np.isfinite(rows).all()
    assert np.isfinite(task.jacobian(model.jacobians(q))).all()
