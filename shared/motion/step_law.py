"""The step law: where and when the swing foot lands, from the present DCM.

In the plane the CoM is a linear inverted pendulum with ω² = g/z. Its divergent component of motion
(DCM) ξ = c + ċ/ω obeys ξ̇ = ω (ξ − p + δ). Here p is the centre of pressure (CoP) in the support
sole, and δ = F/(m ω²) the external force. While p stays, after a time T

    ξ_T = p + (ξ − p) e^{ωT} + δ (e^{ωh} − 1) e^{ω(T−h)}

if the force lasts for a further time h. The law looks one step ahead, over landing times T, CoPs p
and footholds u on a grid, and takes the best of

    J = V_x(ξ_T − u) + V_y(ξ_T − u) + w_u ‖u − ū‖² + w_p ‖p − p̄‖² + w_T (T − T̄)²

among those within reach. ū, p̄ and T̄ are the nominal ones. In a planned step ‖u − u₋‖² is added,
where u₋ is the last choice, so that of two equally good footholds the last one stays. V is the cost
of the steps after this one: a table for each axis, made once by dynamic programming over steps of a
fixed time. It depends on the robot's geometry only. So the edge computes the tables, and the robot
applies them.

All quantities are in the frame of the support sole, with y towards the swing foot. One law
therefore serves both feet. After Khadiv et al. 2016 (step timing) and Englsberger et al. 2015.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shared.motion.ground import Ground
from shared.motion.pendulum import moved_dcm
from shared.motion.stance import Stance
from shared.motion.swing import PEAK_SAMPLES, peak_gains
from shared.robots import Foot, Robot

# Landing times after lift-off, their nominal value, and the time of the steps behind V [s].
_TIMES = (0.22, 0.25, 0.28, 0.32, 0.36, 0.42, 0.5)
_NOMINAL_TIME, _NEXT_TIME = 0.32, 0.35
# Least distance of the sole's inner edges, and the largest reach beside and before the other foot.
_CLEARANCE = 0.02
_REACH_X, _REACH_Y = 0.36, 0.3
# Limits of the swing foot [m/s², m/s].
_MAX_ACCELERATION, _MAX_SPEED = 30.0, 3.2
# Prices of the deviation from the nominal foothold, CoP and time, and of a DCM that no foot
# captures.
_FOOTHOLD_PRICE, _COP_PRICE, _TIME_PRICE, _CAPTURE_PRICE = 1.0, 1.0, 0.3, 30.0
# Price of the distance to the last choice: another foothold has to be better by it.
_CHANGE_PRICE = 1.0
_COP_SHARE = 0.72
_CAPTURE_MARGIN = 0.015
_CENTRE_PRICE = 4.0
_STEPS_AHEAD = 2
# The largest number of intervals in place of one between two CoPs.
_FINEST = 8
# A higher step of the ground is an edge [m]. A message has room for this number of boxes.
_EDGE = 0.01
MAX_NO_GO = 16
_N_FOOTHOLDS, _N_COPS, _N_OFFSETS, _FARTHEST = 33, 7, 81, 1.2


@dataclass(frozen=True)
class NoGo:
    """A rectangle in which no foot may land: bounds of x and of y in the plan's frame [m]."""

    x: tuple[float, float]
    y: tuple[float, float]


@dataclass(frozen=True)
class StepLaw:
    """The tables of the law for one robot.

    `times` (n_t,) are the landing times after lift-off [s]. `footholds_x`, `footholds_y` (n_u,) are
    candidates for the sole's origin, `cops_x`, `cops_y` (n_p,) for the CoP. `offsets` (n_d,) are
    the values of ξ_T − u at which `values_x` and `values_y` (n_d,) are given. Positive y points to
    the other foot.
    """

    omega: float
    width: float
    times: np.ndarray
    footholds_x: np.ndarray
    footholds_y: np.ndarray
    cops_x: np.ndarray
    cops_y: np.ndarray
    cop_nominal: np.ndarray
    offsets: np.ndarray
    values_x: np.ndarray
    values_y: np.ndarray
    going_on_x: np.ndarray
    going_on_y: np.ndarray
    no_go: tuple[NoGo, ...] = ()


@dataclass(frozen=True, slots=True)
class StepQuestion:
    """The state from which the law decides, in the frame of the support sole, y to the other foot.

    `dcm` and `disturbance` are (2,) [m]. `swing` (3, 2) has the position, velocity and acceleration
    of the swing foot's reference. `elapsed` is the time since lift-off and `nominal` (2,) the
    foothold of an undisturbed step. `to_world` (2, 3) takes (x, y, 1) to the plan's frame, for
    no-go boxes. `last` (2,) is the foothold of the last decision on this step, which is left only
    for a better one; None without one.
    """

    dcm: np.ndarray
    disturbance: np.ndarray
    swing: np.ndarray
    elapsed: float
    nominal: np.ndarray
    nominal_time: float | None = None
    goes_on: bool = False
    to_world: np.ndarray | None = None
    last: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class StepChoice:
    """The answer to a question, in its frame.

    `foothold` (2,) [m], the time that is `remaining` until the landing [s], and the CoP (2,) until
    then [m], with the DCM that is expected at the landing.
    """

    foothold: np.ndarray
    remaining: float
    cop: np.ndarray
    dcm_at_end: np.ndarray
    cost: float


def make_step_law(robot: Robot, stance: Stance, ground: Ground | None = None) -> StepLaw:
    """Make the tables for a robot that rests in a stance, and the boxes of a ground."""
    width = stance.width
    sole = next(each for each in robot.soles if each.side is Foot.RIGHT)
    omega = stance.omega
    # The right foot is the support foot: y points to the left one.
    (back, front), (_, inner) = sole.x, sole.y
    cops_x, cops_y = (_cops(start, end) for start, end in (sole.x, sole.y))
    narrowest = 2.0 * inner + _CLEARANCE
    footholds_x = np.linspace(-_REACH_X, _REACH_X, _N_FOOTHOLDS)
    footholds_y = np.linspace(narrowest, width + _REACH_Y, _N_FOOTHOLDS)
    cop_nominal = np.array([(back + front) / 2, 0.0])
    offsets = np.linspace(-_FARTHEST, _FARTHEST, _N_OFFSETS)
    values_x, going_on_x = _values_backwards(
        offsets, omega, _Axis(cops_x, cop_nominal[0], footholds_x, 0.0), (cops_x[0], cops_x[-1])
    )
    # When both feet are down the DCM may be anywhere between their outer edges.
    values_y, going_on_y = _values_backwards(
        offsets,
        omega,
        _Axis(cops_y, cop_nominal[1], footholds_y, width, mirrored=True),
        (cops_y[0], width - cops_y[0]),
    )
    return StepLaw(
        omega=omega,
        width=width,
        times=np.array(_TIMES),
        footholds_x=footholds_x,
        footholds_y=footholds_y,
        cops_x=cops_x,
        cops_y=cops_y,
        cop_nominal=cop_nominal,
        offsets=offsets,
        values_x=values_x,
        values_y=values_y,
        going_on_x=going_on_x,
        going_on_y=going_on_y,
        no_go=() if ground is None else ground_edges(robot, ground),
    )


@dataclass(frozen=True)
class _Axis:
    """The grids of an axis. A `mirrored` axis points to the other foot, so its sign changes with
    every step.
    """

    cops: np.ndarray
    cop_nominal: float
    footholds: np.ndarray
    nominal: float
    mirrored: bool = False


def _values_backwards(
    offsets: np.ndarray, omega: float, axis: _Axis, captured: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """V (n_d,) of a robot that may stop at any landing, and of one that goes on with a step.

    The robot can stop where ξ_T − u is between the numbers `captured`.
    """
    lowest, highest = captured[0] + _CAPTURE_MARGIN, captured[1] - _CAPTURE_MARGIN
    beyond = np.maximum(0.0, np.maximum(lowest - offsets, offsets - highest))
    stop = _CAPTURE_PRICE * beyond**2 + _CENTRE_PRICE * (offsets - (lowest + highest) / 2) ** 2
    growth, cops = math.exp(omega * _NEXT_TIME), axis.cops[:, None]
    # (d, p, u)
    landed = moved_dcm(offsets[:, None, None], cop=cops, growth=growth) - axis.footholds
    price = (
        _COP_PRICE * (cops - axis.cop_nominal) ** 2
        + _FOOTHOLD_PRICE * (axis.footholds - axis.nominal) ** 2
    )
    values, going_on = stop, stop
    for _ in range(_STEPS_AHEAD):
        after = _values(offsets, values, -landed if axis.mirrored else landed)
        going_on = (after + price).min(axis=(1, 2))
        values = np.minimum(stop, going_on)
    return values, going_on


def _cops(start: float, end: float) -> np.ndarray:
    """CoPs along an extent of a sole. The ankle is too weak for those near its ends."""
    centre, half = (start + end) / 2, _COP_SHARE * (end - start) / 2
    return np.linspace(centre - half, centre + half, _N_COPS)


def _values(offsets: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """V at some offsets. Outside the table V grows linearly."""
    found = np.interp(at.ravel(), offsets, values).reshape(at.shape)
    outside = np.abs(at) - offsets[-1]
    beyond = np.maximum(outside, 0.0)
    result: np.ndarray = found + 2.0 * _CAPTURE_PRICE * offsets[-1] * beyond
    return result


def choose_step(
    law: StepLaw, question: StepQuestion, *, least: float, held: float
) -> StepChoice | None:
    """Return the best step, or None if none is within reach.

    The foot lands at least `least` from now [s]. The disturbance stays for `held` [s].
    """
    times, nominal_time = law.times, question.nominal_time
    if nominal_time is None:
        nominal_time = _NOMINAL_TIME
    elif nominal_time not in times:
        times = np.append(times, nominal_time)
    remaining = times - question.elapsed
    remaining = remaining[remaining >= least]
    if len(remaining) == 0:
        return None
    omega = law.omega
    lasting = np.minimum(held, remaining)
    pushed = np.expm1(omega * lasting) * np.exp(omega * (remaining - lasting))
    growth = np.exp(omega * remaining)
    going_on = question.goes_on
    # In a slow step a CoP moves the DCM further, so that its grid is finer there. Else the best
    # foothold between two CoPs is not found, and two worse ones beside it are as good.
    ratio = (growth.max() - 1.0) / math.expm1(omega * law.times[-1])
    finer = min(math.ceil(ratio - 1e-6), _FINEST)
    cops_x, cops_y = (_finer(cops, finer) for cops in (law.cops_x, law.cops_y))
    axes = (
        (cops_x, law.footholds_x, law.going_on_x if going_on else law.values_x, 1.0),
        (cops_y, law.footholds_y, law.going_on_y if going_on else law.values_y, -1.0),
    )
    # For each axis, J without the price of time: for every CoP, (T, p, u), and for the best CoP,
    # (T, u).
    by_cop: list[np.ndarray] = []
    by_foothold: list[np.ndarray] = []
    for axis, (cops, footholds, values, direction) in enumerate(axes):
        dcm, force = question.dcm[axis], question.disturbance[axis]
        at_end = moved_dcm(dcm, cop=cops, growth=growth[:, None]) + (force * pushed)[:, None]
        price = _values(law.offsets, values, direction * (at_end[:, :, None] - footholds))
        price += _COP_PRICE * (cops[:, None] - law.cop_nominal[axis]) ** 2
        price += _FOOTHOLD_PRICE * (footholds - question.nominal[axis]) ** 2
        if question.last is not None:
            price += _CHANGE_PRICE * (footholds - question.last[axis]) ** 2
        within = _within_reach(question.swing[:, axis], footholds, remaining)
        by_cop.append(price)
        by_foothold.append(np.where(within, price.min(axis=1), np.inf))
    price_of_time = _TIME_PRICE * (remaining + question.elapsed - nominal_time) ** 2
    whole = by_foothold[0][:, :, None] + by_foothold[1][:, None, :] + price_of_time[:, None, None]
    if law.no_go and question.to_world is not None:
        whole = whole + _forbidden(law, question.to_world)
    place = int(whole.argmin())
    cost = float(whole.flat[place])
    if not math.isfinite(cost):
        return None
    t, *best = (int(index) for index in np.unravel_index(place, whole.shape))
    foothold, cop = np.empty(2), np.empty(2)
    for axis, k in enumerate(best):
        of_cop = by_cop[axis][t, :, k]
        foothold[axis] = _vertex(axes[axis][1], by_foothold[axis][t], k)
        cop[axis] = _vertex(axes[axis][0], of_cop, int(of_cop.argmin()))
    by_force = question.disturbance * pushed[t]
    at_end = moved_dcm(question.dcm, cop=cop, growth=growth[t]) + by_force
    return StepChoice(foothold, float(remaining[t]), cop, at_end, cost)


def _finer(grid: np.ndarray, factor: int) -> np.ndarray:
    """The same grid with `factor` intervals in place of each."""
    return grid if factor <= 1 else np.linspace(grid[0], grid[-1], factor * (len(grid) - 1) + 1)


def _within_reach(swing: np.ndarray, footholds: np.ndarray, remaining: np.ndarray) -> np.ndarray:
    """Return whether the swing foot can reach each foothold by each landing time, (n_t, n_u)."""
    position, velocity, acceleration = swing.tolist()
    distance = footholds - position
    T = remaining[:, None]
    of_distance, of_velocity, of_acceleration = peak_gains()
    within = np.ones((len(remaining), len(footholds)), dtype=bool)
    for k in range(len(PEAK_SAMPLES)):
        needed = (
            of_distance[k] * distance / T**2
            + of_velocity[k] * velocity / T
            + of_acceleration[k] * acceleration
        )
        within &= np.abs(needed) <= _MAX_ACCELERATION
    speed = 1.875 * distance / T - 0.4375 * velocity
    within &= np.abs(speed) <= _MAX_SPEED
    return within


def _forbidden(law: StepLaw, to_world: np.ndarray) -> np.ndarray:
    """Infinity at the footholds (n_x, n_y) in a no-go box, else 0."""
    x, y = np.meshgrid(law.footholds_x, law.footholds_y, indexing="ij")
    at_x = to_world[0, 0] * x + to_world[0, 1] * y + to_world[0, 2]
    at_y = to_world[1, 0] * x + to_world[1, 1] * y + to_world[1, 2]
    forbidden = np.zeros(x.shape)
    for box in law.no_go:
        inside = (at_x >= box.x[0]) & (at_x <= box.x[1]) & (at_y >= box.y[0]) & (at_y <= box.y[1])
        forbidden[inside] = np.inf
    return forbidden


def _vertex(grid: np.ndarray, values: np.ndarray, k: int) -> float:
    """The minimum of the parabola through the value at k and its neighbours."""
    if not 0 < k < len(grid) - 1:
        return float(grid[k])
    before, here, after = values[k - 1 : k + 2].tolist()
    bend = before - 2.0 * here + after
    if not math.isfinite(bend) or bend <= 1e-12:
        return float(grid[k])
    shift = 0.5 * (before - after) / bend
    return float(grid[k] + min(0.5, max(-0.5, shift)) * (grid[1] - grid[0]))


def ground_edges(robot: Robot, ground: Ground) -> tuple[NoGo, ...]:
    """Return the places where a sole that points along x would be on an edge of the ground, or in a
    hole.

    If there are more than a law can have, the ones nearest to the origin are returned.
    """
    sole = robot.soles[0]
    back, front = sole.x
    aside = max(abs(y) for y in sole.y)
    boxes = []
    for patch in ground.patches:
        (x_0, x_1), (y_0, y_1) = patch.x, patch.y
        if not patch.allowed:
            boxes.append(NoGo((x_0 - front, x_1 - back), (y_0 - aside, y_1 + aside)))
            continue
        middle = (y_0 + y_1) / 2
        for x in (x_0, x_1):
            if abs(ground.height(x - 1e-6, middle) - ground.height(x + 1e-6, middle)) > _EDGE:
                boxes.append(NoGo((x - front, x - back), (y_0 - aside, y_1 + aside)))
    distinct = sorted(set(boxes), key=lambda box: (abs(sum(box.x)) + abs(sum(box.y)), box.x))
    return tuple(distinct[:MAX_NO_GO])
