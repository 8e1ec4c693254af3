"""CoM trajectory of a walk from the linear inverted pendulum above the ground.

With the CoM at height z over the ZMP p the pendulum obeys c̈ = ω² (c − p) in the plane, ω² = g/z.
In the vertical the same law holds for c and the point at height z over p. The contact force then
passes through p and c, also on a stair. A plan is a sequence of segments on which the ZMP moves
linearly. On each the motion has a closed form,

    c(t) = p(t) + A e^{ωt} + B e^{−ωt}.

`dcm_plan` places the ZMP under the support foot, and in between during double support. It
integrates the divergent component of motion (DCM) ξ = c + ċ/ω backwards from rest, which gives the
only motion that does not diverge (Englsberger, Ott & Albu-Schäffer 2015).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.robots import GRAVITY


@dataclass(frozen=True)
class ZmpSegment:
    """ZMP moving linearly from `start` to `end` (3,) in the world [m] between two times [s]."""

    begin: float
    finish: float
    start: np.ndarray
    end: np.ndarray


@dataclass(frozen=True)
class ComState:
    """CoM in the horizontal plane: position, velocity, acceleration (2,), and the ZMP (2,)."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    zmp: np.ndarray


class ComPlan:
    """Pendulum motion over ZMP segments; at rest before the first and after the last.

    `position` is the CoM at the beginning and `capture_point` the DCM at the end, both (3,) [m],
    lowered by the pendulum's height. An error in the CoM shrinks forwards in time, and an error in
    the DCM backwards. Each is therefore integrated in its own direction. If both ran forwards, a
    rounding error would grow by e^{ωt}, to metres in 10 s.
    """

    def __init__(
        self,
        segments: Sequence[ZmpSegment],
        *,
        omega: float,
        position: np.ndarray,
        capture_point: np.ndarray,
    ) -> None:
        self.segments = tuple(segments)
        self.omega = omega
        self._begins = [segment.begin for segment in self.segments]
        # The height of the pendulum [m].
        height = GRAVITY / omega**2
        xi_ends = [capture_point]
        for segment in reversed(self.segments[1:]):
            xi_ends.append(_xi_before(segment, xi_ends[-1], omega))
        self._tables = []
        c = position
        for segment, xi_end in zip(self.segments, reversed(xi_ends), strict=True):
            duration = segment.finish - segment.begin
            slope = (segment.end - segment.start) / duration
            decay = math.exp(-omega * duration)
            # A e^{ωt} at the segment's end, B e^{−ωt} at its beginning: neither ever overflows.
            growing = (xi_end - segment.end - slope / omega) / 2
            decaying = c - segment.start - growing * decay
            self._tables.append(self._table(segment.start, slope, growing, decaying, height))
            c = segment.end + growing + decaying * decay
        zero = np.zeros(3)
        self._at_rest = self._table(c, zero, zero, zero, height)

    @property
    def duration(self) -> float:
        """End of the last segment [s]."""
        return self.segments[-1].finish

    def state(self, time: float) -> ComState:
        """CoM and ZMP at `time` [s]."""
        position, velocity, acceleration = self.motion(time)[:, :2]
        return ComState(
            position, velocity, acceleration, zmp=position - acceleration / self.omega**2
        )

    def motion(self, time: float) -> np.ndarray:
        """CoM at `time` [s]: position, velocity, acceleration as rows, (3, 3)."""
        motion: np.ndarray
        if time >= self.duration:
            motion = self._at_rest[0].reshape(3, 3)
            return motion
        k = max(0, bisect.bisect_right(self._begins, time) - 1)
        segment = self.segments[k]
        t = max(0.0, time - segment.begin)
        up = math.exp(self.omega * (segment.begin + t - segment.finish))
        down = math.exp(-self.omega * t)
        motion = np.array((1.0, t, up, down)).dot(self._tables[k]).reshape(3, 3)
        return motion

    def _table(
        self,
        start: np.ndarray,
        slope: np.ndarray,
        growing: np.ndarray,
        decaying: np.ndarray,
        height: float,
    ) -> np.ndarray:
        """Coefficients (4, 9) of position, velocity and acceleration (3,) each.

        The rows multiply 1, t, e^{ωt} from the segment's end and e^{−ωt} from its beginning. The
        products are summed.
        """
        omega = self.omega
        table = np.zeros((4, 3, 3))
        table[0, 0] = start
        table[0, 0, 2] += height
        table[0, 1] = table[1, 0] = slope
        for k, (part, rate) in enumerate(((growing, omega), (decaying, -omega)), start=2):
            table[k] = part, rate * part, rate**2 * part
        return table.reshape(4, 9)


def dcm_plan(segments: Sequence[ZmpSegment], *, omega: float, position: np.ndarray) -> ComPlan:
    """The bounded pendulum motion that starts at rest at `position` (3,), lowered by the pendulum's
    height, and ends at rest.

    The first segment's ZMP start is free and chosen so that the motion begins at rest.
    """
    # The DCM at the beginning of each segment, backwards from rest at the end.
    xi = segments[-1].end
    for segment in reversed(segments[1:]):
        xi = _xi_before(segment, xi, omega)
    first = segments[0]
    duration = first.finish - first.begin
    # ξ(0) = position fixes the start p₀ of a linear ZMP: ξ(0) = p₀ κ + rest, by linearity.
    at_zero = _xi_before(ZmpSegment(first.begin, first.finish, np.zeros(3), first.end), xi, omega)
    slope = _xi_before(ZmpSegment(0.0, duration, np.ones(3), np.zeros(3)), np.zeros(3), omega)
    start = (position - at_zero) / slope
    whole = (ZmpSegment(first.begin, first.finish, start, first.end), *segments[1:])
    return ComPlan(whole, omega=omega, position=position, capture_point=whole[-1].end)


def _xi_before(segment: ZmpSegment, xi_end: np.ndarray, omega: float) -> np.ndarray:
    """DCM at a segment's beginning, from the DCM at its end."""
    duration = segment.finish - segment.begin
    slope = (segment.end - segment.start) / duration
    offset_end = segment.end + slope / omega
    xi: np.ndarray = (
        segment.start + slope / omega + (xi_end - offset_end) * math.exp(-omega * duration)
    )
    return xi
