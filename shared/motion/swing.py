"""The swing foot between two footprints: a quintic in the plane and in heading, a bump in height.

Between footprints of different heights another quintic is added to the bump. A foot goes up in the
first part of its swing and down in the last one, so that it passes above the edge of a stair.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from shared.motion.footprint import Footprint
from shared.wbc.reference import SwingState

# Part of a swing in which the height changes from one footprint's to the other's.
_CLIMB = 0.35


def quintic(u: float) -> tuple[float, float, float]:
    """10 u³ − 15 u⁴ + 6 u⁵ on [0, 1] and its derivatives: from 0 to 1, at rest at both ends."""
    u = min(1.0, max(0.0, u))
    return (
        u**3 * (10.0 + u * (-15.0 + 6.0 * u)),
        30.0 * u**2 * (1.0 - u) ** 2,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


def bump(u: float) -> tuple[float, float, float]:
    """64 u³ (1 − u)³ on [0, 1] and its derivatives: 0 to 1 to 0, at rest at both ends."""
    u = min(1.0, max(0.0, u))
    w = u * (1.0 - u)
    dw = 1.0 - 2.0 * u
    return 64.0 * w**3, 192.0 * w**2 * dw, 384.0 * w * (dw * dw - w)


def swing(
    start: Footprint, goal: Footprint, *, time: float, duration: float, height: float
) -> SwingState:
    """State `time` [s] after lift-off of a swing of `duration` [s].

    Halfway it is `height` [m] above the higher footprint.
    """
    u, rate = time / duration, 1.0 / duration
    s, ds, dds = quintic(u)
    z, dz, ddz = bump(u)
    x, y, climb = goal.x - start.x, goal.y - start.y, goal.z - start.z
    up, dup, ddup = quintic((u if climb > 0.0 else u - 1.0 + _CLIMB) / _CLIMB)
    dup, ddup = dup * rate / _CLIMB, ddup * (rate / _CLIMB) ** 2
    turn = math.atan2(math.sin(goal.yaw - start.yaw), math.cos(goal.yaw - start.yaw))
    ds, dds = ds * rate, dds * rate**2
    position, velocity, acceleration = np.array(
        (
            (start.x + s * x, start.y + s * y, start.z + climb * up + height * z),
            (ds * x, ds * y, climb * dup + height * dz * rate),
            (dds * x, dds * y, climb * ddup + height * ddz * rate**2),
        )
    )
    return SwingState(position, velocity, acceleration, start.yaw + s * turn, ds * turn, dds * turn)


# The downward speed at which a foot that may land at any height meets the ground [m/s].
_LANDING_SPEED = 0.15
# The downward acceleration of a late foot grows at this rate [m/s³] for this time [s], because the
# DCM diverges until the foot lands.
_FASTER, _FASTER_FOR = 80.0, 0.08
# Part of the swing after which the foot is highest: on level ground, up a stair and down one. So
# the foot passes above the edge. A stair is higher than the last number [m].
_HIGHEST_AT, _HIGHEST_UP, _HIGHEST_DOWN, _STAIR = 0.45, 0.3, 0.6, 0.03
# Where the acceleration of a quintic is largest, in parts of its time.
PEAK_SAMPLES = (0.1, 0.21, 0.4, 0.6, 0.79)


@functools.cache
def peak_gains() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The acceleration at `PEAK_SAMPLES` of a quintic that ends at rest, per D/T², v/T and a.

    D is the distance and T the time. v and a are the velocity and acceleration at the start.
    """
    s = np.array(PEAK_SAMPLES)
    return (
        60.0 * s - 180.0 * s**2 + 120.0 * s**3,
        -36.0 * s + 96.0 * s**2 - 60.0 * s**3,
        1.0 - 9.0 * s + 18.0 * s**2 - 10.0 * s**3,
    )


@dataclass(frozen=True, slots=True)
class SwingPath:
    """The path of a swing foot to a goal that may still change, continuous in acceleration.

    From `begin` the axes (x, y, z, heading) follow quintics with `coefficients` (6, 4). From
    `highest` on, after the part `share` of the swing, the height follows `descent` (6,), down from
    `height` [m] above the higher one of `start` and `goal`. After `end` the foot goes on down.
    """

    lift_off: float
    begin: float
    highest: float
    end: float
    height: float
    share: float
    coefficients: np.ndarray
    descent: np.ndarray
    start: Footprint
    goal: Footprint

    @staticmethod
    def between(
        start: Footprint, goal: Footprint, *, begin: float, end: float, height: float
    ) -> SwingPath:
        """The path of a foot that lifts at `begin` and lands at `end` [s].

        `height` is above the higher one of the two footprints [m].
        """
        at_rest = np.zeros((3, 4))
        at_rest[0] = start.x, start.y, start.z, start.yaw
        climb = goal.z - start.z
        share = _HIGHEST_AT
        if abs(climb) > _STAIR:
            share = _HIGHEST_UP if climb > 0.0 else _HIGHEST_DOWN
        return _path(
            at_rest, start, goal, lift_off=begin, begin=begin, end=end, height=height, share=share
        )

    def retargeted(self, goal: Footprint, *, time: float, end: float) -> SwingPath:
        """The path that leaves this one at `time` and lands on `goal` at `end`."""
        return _path(
            self._axes(time),
            self.start,
            goal,
            lift_off=self.lift_off,
            begin=time,
            end=end,
            height=self.height,
            share=self.share,
        )

    def state(self, time: float) -> SwingState:
        """The foot at `time` [s]."""
        axes = self._axes(time)
        position, velocity, acceleration = axes[:, :3]
        yaw, yaw_rate, yaw_acceleration = axes[:, 3].tolist()
        return SwingState(position, velocity, acceleration, yaw, yaw_rate, yaw_acceleration)

    def _axes(self, time: float) -> np.ndarray:
        """Position, velocity and acceleration (3,) of the axes, (3, 4)."""
        axes: np.ndarray = _powers(min(time, self.end) - self.begin).dot(self.coefficients)
        if time >= self.highest:
            axes[:, 2] = _powers(min(time, self.end) - self.highest).dot(self.descent)
        if time > self.end:
            late = min(time - self.end, _FASTER_FOR)
            faster = 0.5 * _FASTER * late**2
            axes[0, 2] -= _LANDING_SPEED * (time - self.end) + _FASTER * late**3 / 6.0
            axes[0, 2] -= faster * (time - self.end - late)
            axes[1, 2] -= faster
            if time < self.end + _FASTER_FOR:
                axes[2, 2] -= _FASTER * late
        return axes


def _powers(t: float) -> np.ndarray:
    """The powers of t and their first and second derivatives, (3, 6)."""
    t_2 = t * t
    t_3 = t_2 * t
    t_4 = t_3 * t
    return np.array(
        (
            (1.0, t, t_2, t_3, t_4, t_4 * t),
            (0.0, 1.0, 2.0 * t, 3.0 * t_2, 4.0 * t_3, 5.0 * t_4),
            (0.0, 0.0, 2.0, 6.0 * t, 12.0 * t_2, 20.0 * t_3),
        )
    )


def _quintic_through(start: np.ndarray, end: np.ndarray, duration: float) -> np.ndarray:
    """Coefficients (6, n) of the quintics from one state to another, (3, n) each."""
    x_0, v_0, a_0 = start
    x_1, v_1, a_1 = end
    T = duration
    D = x_1 - x_0
    return np.array(
        (
            x_0,
            v_0,
            0.5 * a_0,
            (20.0 * D - (8.0 * v_1 + 12.0 * v_0) * T - (3.0 * a_0 - a_1) * T**2) / (2.0 * T**3),
            (-30.0 * D + (14.0 * v_1 + 16.0 * v_0) * T + (3.0 * a_0 - 2.0 * a_1) * T**2)
            / (2.0 * T**4),
            (12.0 * D - 6.0 * (v_1 + v_0) * T + (a_1 - a_0) * T**2) / (2.0 * T**5),
        )
    )


def _path(
    state: np.ndarray,
    start: Footprint,
    goal: Footprint,
    *,
    lift_off: float,
    begin: float,
    end: float,
    height: float,
    share: float,
) -> SwingPath:
    """The path from a state (3, 4) at `begin` to a footprint at `end`.

    The foot is highest after the part `share` of the swing, by `height` above the higher one of the
    footprints `start` and `goal`.
    """
    yaw = state[0, 3] + math.remainder(goal.yaw - state[0, 3], math.tau)
    landed = np.zeros((3, 4))
    landed[0] = goal.x, goal.y, goal.z, yaw
    coefficients = _quintic_through(state, landed, end - begin)
    down = np.array([goal.z, -_LANDING_SPEED, 0.0])
    highest = lift_off + share * (end - lift_off)
    if highest - begin > 0.02:
        turning = np.array([max(start.z, goal.z) + height, 0.0, 0.0])
        coefficients[:, 2] = _quintic_through(state[:, 2], turning, highest - begin)
        descent = _quintic_through(turning, down, end - highest)
    else:
        highest = begin
        descent = _quintic_through(state[:, 2], down, end - begin)
    return SwingPath(
        lift_off, begin, highest, end, height, share, coefficients, descent, start, goal
    )
