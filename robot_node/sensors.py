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
        noise = self._rng.standard_normal((2, len(v) - 6))
        q[7:] += self._config.joint_position_noise * noise[0]
        v[6:] += self._config.joint_velocity_noise * noise[1]
        return q, v
