"""Measurement noise: Gaussian on joint positions and velocities, none on the floating base.

The paper gives one σ for "the joint measurements"; we read it as joint positions in rad.
"""

from __future__ import annotations

import numpy as np

from shared.config.settings import SensorConfig


class Sensors:
    """Turns true states into measured ones. The same seed gives the same noise."""

    def __init__(self, config: SensorConfig, *, seed: int) -> None:
        self._config = config
        self._seed = seed
        self.restart()

    def restart(self) -> None:
        """Begin the noise sequence anew, so that a run does not depend on how long it waited."""
        self._rng = np.random.default_rng([self._seed, 1])

    def measure(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measured (q, v) from the true ones, shapes (nq,) and (nv,)."""
        q, v = q.copy(), v.copy()
        of_positions, of_velocities = self._rng.standard_normal((2, len(v) - 6))
        joints = q[7:]
        joints += self._config.joint_position_noise * of_positions
        if self._config.joint_velocity_noise > 0.0:
            rates = v[6:]
            rates += self._config.joint_velocity_noise * of_velocities
        return q, v
