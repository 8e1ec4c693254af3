"""The limits of MuJoCo's robot: ranges of joints, velocity limits of motors, legs that meet."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from robot_node.plant import MujocoPlant
from shared.config.robot_settings import PlantConfig
from shared.robots import CATALOGUE, Foot, load_robot


@pytest.fixture(scope="module", params=list(CATALOGUE))
def any_robot(request):
    return load_robot(request.param)


def hanging(robot, **config):
    """The robot in the air, held by nothing, without gravity."""
    plant = MujocoPlant(robot, PlantConfig(**config))
    q = robot.q_standing.copy()
    q[2] += 5.0
    plant.set_state(q, np.zeros(robot.model.nv))
    plant.model.opt.gravity[:] = 0.0
    return plant


def drive(plant, robot, joint, torque, ticks):
    """The positions of a joint under a constant torque."""
    tau, positions = np.zeros(len(robot.effort_limit)), []
    tau[joint] = torque
    for _ in range(ticks):
        plant.step(tau, push=np.zeros(3))
        positions.append(plant.state()[0][7 + joint])
    return np.array(positions)


def test_a_joint_stops_at_its_range_only_if_the_plant_has_limits(any_robot):
    robot = any_robot
    joint = robot.sole_frame(Foot.LEFT).parentJoint - 2
    highest = robot.position_limit[1, joint]
    # Feet differ: each is driven by the same acceleration, 40 rad/s².
    inertia = pin.crba(robot.model, robot.model.createData(), robot.q_standing)[
        6 + joint, 6 + joint
    ]
    free = drive(hanging(robot), robot, joint, 40.0 * inertia, 400)
    stopped = drive(hanging(robot, joint_limits=True), robot, joint, 40.0 * inertia, 400)
    assert free.max() > highest + 0.1
    # The stop is as soft as a contact.
    assert highest - 0.01 < stopped.max() < highest + 0.02


def test_a_motor_at_its_velocity_limit_drives_no_faster(robot):
    joint = robot.model.getJointId("LElbowRoll") - 2
    fastest = robot.velocity_limit[joint]
    for config, low, high in (({}, 1.2, 50.0), ({"velocity_limits": True}, 0.9, 1.1)):
        positions = drive(hanging(robot, **config), robot, joint, 1.0, 100)
        assert low * fastest < np.diff(positions).max() * 1e3 < high * fastest


def test_a_motor_beyond_its_velocity_limit_may_brake(robot):
    plant = hanging(robot, velocity_limits=True)
    joint = robot.model.getJointId("LElbowRoll") - 2
    v = np.zeros(robot.model.nv)
    v[6 + joint] = 2.0 * robot.velocity_limit[joint]
    plant.set_state(plant.state()[0], v)
    tau = np.zeros(31)
    tau[joint] = -1.0
    plant.step(tau, push=np.zeros(3))
    assert plant.state()[1][6 + joint] < 0.99 * v[6 + joint]


def test_legs_meet_only_if_they_collide(any_robot):
    robot = any_robot
    # The second joint of the left leg, after its yaw: roll, here by 0.3 rad to either side.
    foot = robot.sole_frame(Foot.LEFT).parentJoint
    roll = [joint for joint in robot.model.supports[foot] if joint > 1][1] - 2

    def meetings(**config):
        plant, met = hanging(robot, **config), []
        for sign in (-1.0, 1.0):
            q = plant.state()[0]
            q[7 + roll] = sign * 0.3
            plant.set_state(q, np.zeros(robot.model.nv))
            for contact in plant.data.contact:
                names = [plant.model.geom(geom).name for geom in (contact.geom1, contact.geom2)]
                met.append([name.split("_")[0] for name in names])
        return met

    assert meetings() == []
    met = meetings(leg_collision=True)
    assert met
    assert all(sorted(pair) == ["left", "right"] for pair in met)


def test_a_standing_robot_touches_nothing_but_the_floor(any_robot):
    plant = MujocoPlant(any_robot, PlantConfig(leg_collision=True, joint_limits=True))
    floor = plant.model.geom("floor").id
    assert plant.data.ncon > 0
    assert all(contact.geom1 == floor for contact in plant.data.contact)
    assert plant.model.body_mass.sum() == pytest.approx(any_robot.mass)
