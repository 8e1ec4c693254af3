"""Checks of any plant: `./wbc plant check`, or `plant_faults` in a test.

A plant is a `Plant` (`robot_node/plant.py`). The checks look at conventions that a simulation or a
driver easily gets wrong: frames and signs, the units of contact forces, and memory that is shared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin

from robot_node.plant import Plant
from robot_node.safety import JointHold
from shared.robots import GRAVITY, Foot, Robot
from shared.robots.standing import standing_torques

_TURN = 0.5
_TICKS = 50
# Ticks after which contacts have come to rest.
_SETTLED = 200
_NO_PUSH = np.zeros(3)
_PUSH = 20.0

Make = Callable[[], Plant]
Check = Callable[[Make, Robot, float], Iterator[str]]


def plant_faults(make: Make, robot: Robot, *, timestep: float = 1e-3) -> dict[str, list[str]]:
    """Return the faults of a plant by check; `make` makes a new one, `timestep` [s].

    The checks put the robot at states near its standing posture and advance it by a second in all.
    """
    return {name: list(check(make, robot, timestep)) for name, check in CHECKS.items()}


def _state_comes_back(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    plant = make()
    q, v = _turned(robot), np.zeros(robot.model.nv)
    plant.set_state(q, v)
    got_q, got_v = plant.state()
    for name, got, expected in (("q", got_q, q), ("v", got_v, v)):
        if got.shape != expected.shape:
            yield f"expected {name} of shape {expected.shape} from state(), got {got.shape}"
        elif not np.allclose(got, expected, atol=1e-9):
            k = int(np.abs(got - expected).argmax())
            yield (
                f"expected state() to return the state that was set, {name}[{k}] = "
                f"{expected[k]:.4g}, got {got[k]:.4g}; the base's quaternion is x, y, z, w, and "
                "the order of joints that of the robot's model"
            )
    before = plant.state()[0].copy()
    got_q += 1.0
    if not np.array_equal(plant.state()[0], before):
        yield "expected copies from state(), got arrays whose change moves the plant; return copies"


def _moves_as_its_velocity(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    plant = make()
    model, tau = robot.model, standing_torques(robot)
    plant.set_state(_turned(robot), np.zeros(model.nv))
    push = np.array([_PUSH, 0.0, 0.0])
    for tick in range(_TICKS):
        q0, v0 = plant.state()
        plant.step(tau, push=push)
        q1, v1 = plant.state()
        moved = pin.difference(model, q0, q1) / timestep
        # Any integrator lies between the velocities before and after a step.
        allowed = 1e-6 + 1.01 * np.abs(v1 - v0).max()
        miss = np.abs(moved - (v0 + v1) / 2).max()
        if not miss <= allowed:
            k = int(np.abs(moved - (v0 + v1) / 2).argmax())
            yield (
                f"expected q to move by v in a timestep of {timestep:g} s, got v[{k}] = "
                f"{v1[k]:.4g} and a motion of q at {moved[k]:.4g} in tick {tick}; v has the base's "
                "velocities in the base frame, linear then angular"
            )
            return


def _stands(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    plant = _standing(make, robot, timestep)
    fall = float(robot.q_standing[2] - plant.state()[0][2])
    if not abs(fall) < 0.01:
        yield (
            f"expected the robot to stand for {_SETTLED} ticks, got a fall by {fall:.3f} m; are "
            "the torques applied, and is the floor at z = 0?"
        )


def _bears_its_weight(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    forces = _standing(make, robot, timestep).contact_forces()
    if set(forces) != set(Foot) or any(np.shape(force) != (3,) for force in forces.values()):
        yield f"expected a force (3,) for each foot from contact_forces(), got {forces!r}"
        return
    weight, total = robot.mass * GRAVITY, float(sum(force[2] for force in forces.values()))
    if not abs(total - weight) < 0.1 * weight:
        yield (
            f"expected forces of the floor that bear {weight:.0f} N, got {total:.0f}; they act on "
            "the soles, in the world, in newtons"
        )


def _takes_a_push(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    names = "xyz"
    for axis in range(2):
        push = np.zeros(3)
        push[axis] = _PUSH
        moved = _base_velocity(make, robot, push) - _base_velocity(make, robot, _NO_PUSH)
        if not moved[axis] > 0.0 or abs(moved[1 - axis]) > moved[axis]:
            yield (
                f"expected a push along {names[axis]} of the world to move the base along "
                f"{names[axis]}, got a change of velocity of {np.round(moved, 5).tolist()} m/s"
            )


def _obeys_torques(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    plant, model, tau = make(), robot.model, standing_torques(robot)
    at_rest = _joint_velocities(plant, robot, tau)
    inertia = np.diag(pin.crba(model, model.createData(), robot.q_standing))[6:]
    in_legs = {j for side in Foot for j in model.supports[robot.sole_frame(side).parentJoint]}
    free = [joint - 2 for joint in range(2, model.njoints) if joint not in in_legs]
    for joint in free or range(len(tau)):
        more = tau.copy()
        more[joint] += inertia[joint]
        moved = (_joint_velocities(plant, robot, more) - at_rest)[joint]
        if not moved > 0.0:
            yield (
                f"expected a torque on {model.names[joint + 2]} to accelerate that joint, got a "
                f"change of velocity of {moved:.4g} rad/s; check the order and the signs of motors"
            )


def _repeats_itself(make: Make, robot: Robot, timestep: float) -> Iterator[str]:
    plant = make()
    ends = []
    for _ in range(2):
        plant.set_state(robot.q_standing, np.zeros(robot.model.nv))
        for _ in range(_TICKS):
            plant.step(standing_torques(robot), push=_NO_PUSH)
        ends.append(plant.state()[0])
    if not np.array_equal(ends[0], ends[1]):
        yield (
            "expected the same state after the same steps, got a difference of "
            f"{np.abs(ends[0] - ends[1]).max():.2g}; set_state has to reset the whole "
            "memory of the plant, also warm starts"
        )


CHECKS: dict[str, Check] = {
    "state() returns copies of the state that was set": _state_comes_back,
    "q moves by v, in Pinocchio's convention": _moves_as_its_velocity,
    "the robot stands while it holds its joints": _stands,
    "contact forces bear the weight": _bears_its_weight,
    "a push moves the base in the world": _takes_a_push,
    "torques accelerate their joints": _obeys_torques,
    "the same steps give the same state": _repeats_itself,
}


def _turned(robot: Robot) -> np.ndarray:
    """The standing configuration (nq,), turned on the floor, so that frames differ."""
    q = robot.q_standing.copy()
    turn = pin.Quaternion(pin.utils.rotate("z", _TURN))
    q[3:7] = (turn * pin.Quaternion(q[6], q[3], q[4], q[5])).coeffs()
    return q


def _standing(make: Make, robot: Robot, timestep: float) -> Plant:
    """A plant after its contacts have come to rest."""
    plant = make()
    plant.set_state(robot.q_standing, np.zeros(robot.model.nv))
    # With stiff joints: on its standing torques alone the robot is an inverted pendulum.
    hold = JointHold(robot, timestep=timestep)
    for _ in range(_SETTLED):
        q, v = plant.state()
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            break
        hold.observe(q)
        plant.step(hold.torque(q, v), push=_NO_PUSH)
    return plant


def _base_velocity(make: Make, robot: Robot, push: np.ndarray) -> np.ndarray:
    """Velocity of the turned robot's base in the world after ten ticks of a push (3,) [m/s]."""
    plant, tau = make(), standing_torques(robot)
    plant.set_state(_turned(robot), np.zeros(robot.model.nv))
    for _ in range(10):
        plant.step(tau, push=push)
    q, v = plant.state()
    velocity: np.ndarray = pin.Quaternion(q[6], q[3], q[4], q[5]).toRotationMatrix() @ v[:3]
    return velocity


def _joint_velocities(plant: Plant, robot: Robot, tau: np.ndarray) -> np.ndarray:
    """Velocities (nv − 6,) of the joints after one tick under torques [rad/s]."""
    plant.set_state(robot.q_standing, np.zeros(robot.model.nv))
    plant.step(tau, push=_NO_PUSH)
    return plant.state()[1][6:]
