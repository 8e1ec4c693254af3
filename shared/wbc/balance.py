"""The balance law: feedback on the divergent component of motion (DCM).

The CoM accelerates by c̈ = ω² (c − p) + F/m. Here p is the centre of pressure (CoP), ω² = g/z, and z
is the height of the CoM over the lowest loaded sole. The law asks for the CoP

    p = p_r + (1 + k/ω) (ξ − ξ_r) + δ̂       ξ = c + ċ/ω,  p_r = c_r − c̈_r/ω²

and gives the CoM's task c̈* = ω² (c − p) in the plane. The support is the convex hull of the loaded
soles. A CoP more than `beyond` outside it is moved there. No real CoP is outside the support: the
QP then turns the trunk instead (hip strategy). δ̂ = F/(m ω²) is the external force as the shift of
the CoP that balances it. An observer estimates it from the change of ċ and the commanded forces.

After Englsberger, Ott & Albu-Schäffer 2015 (DCM) and Stephens 2007 (hip strategy).
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from shared.config.control_settings import BalanceConfig
from shared.robots import GRAVITY, Foot, Robot
from shared.robots.fallen import LEAST_COM_HEIGHT
from shared.wbc.contacts import ContactMode
from shared.wbc.model import Kinematics
from shared.wbc.reference import Reference

# The support is computed again when a sole has moved by this distance [m].
_MOVED = 2e-3
# The largest force of an estimate, as an acceleration of the robot's mass [m/s²]. A larger one is
# from a fall or a fault, and would last long after it. Robots that stand have up to 6.
_STRONGEST = GRAVITY

Point = tuple[float, float]


class BalanceLaw:
    """The feedback of the CoM in the plane, with the observer's memory. One call a tick."""

    def __init__(self, robot: Robot, config: BalanceConfig, *, period: float) -> None:
        self._config = config
        self._mass = robot.mass
        # Share of the newest tick in the estimate, per second of difference.
        self._share = min(1.0, period / config.observer_time) if config.observer_time else 0.0
        self._period = period
        self._corners = {sole.side: sole.corners() for sole in robot.soles}
        self._disturbance: Point = (0.0, 0.0)
        self._height = 1.0
        self._last_velocity: Point | None = None
        self._support: list[Point] = []
        self._support_of: tuple[ContactMode, list[list[float]]] | None = None

    def com_command(
        self, now: Kinematics, reference: Reference, wrenches: dict[Foot, np.ndarray]
    ) -> np.ndarray:
        """The acceleration asked of the CoM in the plane, (2,) in the world [m/s²].

        `wrenches` (6,) in the sole frames [N, N m] are those of the last command. In a step the
        reference already has a command, which stays.
        """
        x, y, height = now.com.tolist()
        rate_x, rate_y, _ = now.com_velocity.tolist()
        soles = {foot: now.sole_placement(foot) for foot in reference.mode.feet}
        origins = [sole.translation.tolist() for sole in soles.values()]
        ground = min(origin[2] for origin in origins)
        self._height = max(height - ground, LEAST_COM_HEIGHT)
        omega_2 = GRAVITY / self._height
        omega, gain = math.sqrt(omega_2), self._config.gain
        x_ref, y_ref, _ = reference.com.tolist()
        rate_x_ref, rate_y_ref, _ = reference.com_velocity.tolist()
        a_x_ref, a_y_ref, _ = reference.com_acceleration.tolist()
        share = 1.0 + gain / omega
        cop_x = x_ref - a_x_ref / omega_2 + share * (x - x_ref + (rate_x - rate_x_ref) / omega)
        cop_y = y_ref - a_y_ref / omega_2 + share * (y - y_ref + (rate_y - rate_y_ref) / omega)
        force_x, force_y = self._observed((rate_x, rate_y), soles, wrenches)
        if reference.com_command is not None:
            return reference.com_command
        if math.hypot(force_x, force_y) > self._config.dead_band * omega_2:
            cop_x, cop_y = cop_x + force_x / omega_2, cop_y + force_y / omega_2
        self._find_support(reference.mode, soles, origins)
        cop_x, cop_y = within(self._support, (cop_x, cop_y), beyond=self._config.beyond)
        return np.array((omega_2 * (x - cop_x), omega_2 * (y - cop_y)))

    @property
    def disturbance(self) -> np.ndarray:
        """The external force as the shift of the CoP that balances it, (2,) in the world [m].

        It is zero within the dead band.
        """
        shift = np.array(self._disturbance) * (self._height / GRAVITY)
        return shift if math.hypot(*shift.tolist()) > self._config.dead_band else np.zeros(2)

    def _find_support(
        self, mode: ContactMode, soles: dict[Foot, pin.SE3], origins: list[list[float]]
    ) -> None:
        """Compute the support, unless it is that of the last tick."""
        if self._support_of is not None:
            last_mode, last_origins = self._support_of
            if mode is last_mode and all(
                abs(now[0] - last[0]) + abs(now[1] - last[1]) < _MOVED
                for now, last in zip(origins, last_origins, strict=True)
            ):
                return
        corners = [
            self._corners[foot] @ sole.rotation.T + sole.translation for foot, sole in soles.items()
        ]
        self._support = convex_hull(np.concatenate(corners)[:, :2])
        self._support_of = (mode, origins)

    def _observed(
        self, velocity: Point, soles: dict[Foot, pin.SE3], wrenches: dict[Foot, np.ndarray]
    ) -> Point:
        """The estimate of F/m in the plane [m/s²]."""
        last, self._last_velocity = self._last_velocity, velocity
        if last is not None and wrenches and self._share > 0.0:
            seen_x = (velocity[0] - last[0]) / self._period
            seen_y = (velocity[1] - last[1]) / self._period
            for foot, sole in soles.items():
                if foot in wrenches:
                    force_x, force_y, _ = sole.rotation.dot(wrenches[foot][:3]).tolist()
                    seen_x -= force_x / self._mass
                    seen_y -= force_y / self._mass
            x, y = self._disturbance
            x, y = x + self._share * (seen_x - x), y + self._share * (seen_y - y)
            size = math.hypot(x, y)
            if size > _STRONGEST:
                x, y = x / size * _STRONGEST, y / size * _STRONGEST
            if math.isfinite(size):
                self._disturbance = (x, y)
        return self._disturbance


def convex_hull(points: np.ndarray) -> list[Point]:
    """Corners of the convex hull of points (n, 2), counter-clockwise (Andrew 1979)."""
    ordered = sorted((x, y) for x, y in points.tolist())
    lower, upper = _chain(ordered), _chain(ordered[::-1])
    return lower[:-1] + upper[:-1]


def _chain(points: list[Point]) -> list[Point]:
    chain: list[Point] = []
    for point in points:
        while len(chain) >= 2 and _left_of(chain[-2], chain[-1], point) <= 0.0:
            chain.pop()
        chain.append(point)
    return chain


def _left_of(start: Point, end: Point, point: Point) -> float:
    """Twice the area of the triangle, positive if the point is to the left of the line."""
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])


def within(hull: list[Point], point: Point, *, beyond: float) -> Point:
    """The point if it is at most `beyond` outside the hull, else the nearest point that is."""
    edges = list(zip(hull, hull[1:] + hull[:1], strict=True))
    if all(_left_of(start, end, point) >= 0.0 for start, end in edges):
        return point
    distance, edge = min(_nearest(start, end, point) for start, end in edges)
    if distance <= beyond:
        return point
    share = beyond / distance
    return edge[0] + share * (point[0] - edge[0]), edge[1] + share * (point[1] - edge[1])


def _nearest(start: Point, end: Point, point: Point) -> tuple[float, Point]:
    """The distance of a point from an edge, and the edge's nearest point."""
    along = (end[0] - start[0], end[1] - start[1])
    to_point = (point[0] - start[0], point[1] - start[1])
    length_2 = along[0] ** 2 + along[1] ** 2
    share = (along[0] * to_point[0] + along[1] * to_point[1]) / length_2 if length_2 else 0.0
    share = min(1.0, max(0.0, share))
    nearest = (start[0] + share * along[0], start[1] + share * along[1])
    return math.hypot(point[0] - nearest[0], point[1] - nearest[1]), nearest
