"""Transition from one motion to another that has the same contacts for a while, without a jump."""

from __future__ import annotations

import dataclasses

import numpy as np

from shared.motion.swing import quintic
from shared.wbc.reference import Motion, Reference

# The two CoM trajectories are some millimetres apart: over this time neither jumps [s].
DURATION = 0.4


class CrossFade:
    """`before` until `begin_ns`, then a transition of `DURATION` to `after`, in position and its
    two derivatives.
    """

    def __init__(self, before: Motion, after: Motion, *, begin_ns: int) -> None:
        self.digest = before.digest
        self._before = before
        self._after = after
        self._begin_ns = begin_ns

    def reference(self, time_ns: int) -> Reference:
        """The CoM is mixed; contacts and feet are those of the motion ahead."""
        u = (time_ns - self._begin_ns) * 1e-9 / DURATION
        after = self._after.reference(time_ns)
        if u >= 1.0:
            return after
        before = self._before.reference(time_ns)
        if u <= 0.0:
            return before
        s, ds, dds = quintic(u)
        ds, dds = ds / DURATION, dds / DURATION**2
        apart = after.com - before.com
        apart_velocity = after.com_velocity - before.com_velocity
        apart_acceleration = after.com_acceleration - before.com_acceleration
        velocity: np.ndarray = before.com_velocity + s * apart_velocity + ds * apart
        return dataclasses.replace(
            after,
            com=before.com + s * apart,
            com_velocity=velocity,
            com_acceleration=before.com_acceleration
            + s * apart_acceleration
            + 2.0 * ds * apart_velocity
            + dds * apart,
        )

    def next_switch(self, time_ns: int) -> int | None:
        return (self._before if time_ns < self._begin_ns else self._after).next_switch(time_ns)

    def stopped(self, time_ns: int) -> Motion:
        return self
