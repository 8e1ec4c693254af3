"""Measurement errors: of joint encoders, of the base's estimate, and of force sensors in the feet.

The paper gives one σ for "the joint measurements"; we read it as joint positions in rad. The base's
position and velocity come from an estimator, its orientation and angular velocity from an inertial
measurement unit. They are exact by default.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from shared.config.robot_settings import SensorConfig
from shared.robots import Foot


class Sensors:
    """Turns true states into measured ones. The same seed gives the same errors."""

    def __init__(self, config: SensorConfig, *, seed: int, period: float = 1e-3) -> None:
        self._config = config
        self._seed = seed
        self._drift_step = config.base_position_drift * np.sqrt(period)
        self._base_is_exact = not any(
            (
                *(config.base_position_noise, config.base_position_drift),
                *(config.base_velocity_noise, config.tilt_noise, config.tilt_bias),
                *(config.gyro_noise, config.gyro_bias),
            )
        )
        self.restart()

    def restart(self) -> None:
        """Begin the noise sequence anew, so that a run does not depend on how long it waited."""
        self._rng = np.random.default_rng([self._seed, 1])
        # Separate generators, so that the joints' noise is the same with and without the others.
        self._base_rng = np.random.default_rng([self._seed, 2])
        self._force_rng = np.random.default_rng([self._seed, 3])
        self._drift = np.zeros(3)
        tilt, gyro = self._base_rng.standard_normal((2, 3))
        self._tilt_bias = self._config.tilt_bias * tilt
        self._gyro_bias = self._config.gyro_bias * gyro

    def measure(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measured (q, v) from the true ones, shapes (nq,) and (nv,)."""
        q, v = q.copy(), v.copy()
        of_positions, of_velocities = self._rng.standard_normal((2, len(v) - 6))
        joints = q[7:]
        joints += self._config.joint_position_noise * of_positions
        if self._config.joint_velocity_noise > 0.0:
            rates = v[6:]
            rates += self._config.joint_velocity_noise * of_velocities
        if not self._base_is_exact:
            self._disturb_base(q, v)
        return q, v

    def forces(self, forces: dict[Foot, np.ndarray]) -> dict[Foot, np.ndarray]:
        """Measured contact forces (3,) on the feet from the true ones [N]."""
        noise = self._config.force_noise
        return {
            foot: force + noise * self._force_rng.standard_normal(3)
            for foot, force in forces.items()
        }

    def _disturb_base(self, q: np.ndarray, v: np.ndarray) -> None:
        config = self._config
        of_drift, of_position, of_velocity, of_tilt, of_gyro = self._base_rng.standard_normal(
            (5, 3)
        )
        self._drift += self._drift_step * of_drift
        q[:3] += self._drift + config.base_position_noise * of_position
        turned = pin.exp3(self._tilt_bias + config.tilt_noise * of_tilt)
        world_from_base = pin.Quaternion(q[3:7]).toRotationMatrix()
        q[3:7] = pin.Quaternion(world_from_base @ turned).coeffs()
        v[:3] += config.base_velocity_noise * of_velocity
        v[3:6] += self._gyro_bias + config.gyro_noise * of_gyro
