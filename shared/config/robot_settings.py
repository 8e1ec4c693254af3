"""Settings of the robot `[robot]`, its simulation `[plant]` and its measurements `[sensors]`."""

from __future__ import annotations

from dataclasses import dataclass

from shared.config.extensions import PLANTS
from shared.config.setting import setting
from shared.robots.catalogue import ROBOTS


@dataclass(frozen=True)
class RobotConfig:
    """The robot, by its name or its robot file."""

    name: str = setting("romeo", help="the robot", choices=ROBOTS, flag="--robot")
    torque_clamp: float = setting(
        1.45, help="limit on a commanded torque, × the URDF's effort limit", at_least=0.01
    )

    @property
    def label(self) -> str:
        """The robot's name on the link, in titles and tables."""
        return ROBOTS.label(self.name)


@dataclass(frozen=True)
class PlantConfig:
    """The simulated plant: `mujoco`, or `rigid` with both soles welded to the floor, for balance.

    The other settings are for MuJoCo. The plant's ground is the planned one, unless there is an
    `unknown_ground`.
    """

    kind: str = setting("mujoco", help="kind of plant", choices=PLANTS, flag="--plant")
    friction: float = setting(0.8, help="friction μ between sole and floor", at_least=1e-3)
    contact_time_constant: float = setting(
        0.005, help="time constant of a contact, in `solref`", unit="s"
    )
    contact_damping_ratio: float = setting(1.0, help="damping ratio of a contact, in `solref`")
    joint_limits: bool = setting(False, help="joints stop at the URDF's position limits")
    velocity_limits: bool = setting(
        False, help="a motor at the URDF's velocity limit drives its joint no faster"
    )
    leg_collision: bool = setting(False, help="the legs collide with each other")
    unknown_ground: str = setting(
        "",
        help="the plant's ground in place of the planned one, in the same forms",
        flag="--unknown-ground",
        metavar="blocks:2cm",
    )


@dataclass(frozen=True)
class SensorConfig:
    """Errors of the robot's measurements.

    Noise is Gaussian and new in each tick. The seed draws the bias of a run, with the setting as
    its standard deviation. The drift is a random walk.
    """

    joint_position_noise: float = setting(
        1e-2, help="standard deviation of joint positions", unit="rad", at_least=0.0, flag="--noise"
    )
    joint_velocity_noise: float = setting(
        0.0, help="standard deviation of joint velocities", unit="rad/s", at_least=0.0
    )
    base_position_noise: float = setting(
        0.0, help="standard deviation of the base's position", unit="m", at_least=0.0
    )
    base_position_drift: float = setting(
        0.0, help="drift of the base's position in a second", unit="m/√s", at_least=0.0
    )
    base_velocity_noise: float = setting(
        0.0, help="standard deviation of the base's velocity", unit="m/s", at_least=0.0
    )
    tilt_noise: float = setting(
        0.0, help="standard deviation of the base's orientation", unit="rad", at_least=0.0
    )
    tilt_bias: float = setting(0.0, help="bias of the base's orientation", unit="rad", at_least=0.0)
    gyro_noise: float = setting(
        0.0, help="standard deviation of the base's angular velocity", unit="rad/s", at_least=0.0
    )
    gyro_bias: float = setting(
        0.0, help="bias of the base's angular velocity", unit="rad/s", at_least=0.0
    )
    measure_forces: bool = setting(False, help="the robot measures the forces on its feet")
    force_noise: float = setting(
        0.0, help="standard deviation of a foot's measured force", unit="N", at_least=0.0
    )
