"""CoM trajectory of a walk by model predictive control of the linear inverted pendulum.

This is the alternative to `dcm_plan`, after Herdt et al. 2010 ("Online walking motion generation
with automatic footstep placement", Advanced Robotics 24) and Wieber 2006. From every sample time a
horizon of `PREVIEW` is optimised and its first interval is walked. Over the samples of a horizon, Δ
apart,

    minimise    Σ Δ (α ‖c⃛‖² + β ‖ċ − ċ_ref‖² + γ ‖p − p_ref‖²),    c̈ = ω² (c − p);
    subject to  p inside the support polygon, shrunk by `MARGIN`;
                ξ = c + ċ/ω inside it at the end of the horizon;
                c = ξ = p between the feet if the horizon reaches the end of the walk.

Differences from Herdt, and their reasons:

- The unknowns are the ZMP at the samples, linear in between; his jerk is constant between samples
  100 ms apart. So the ZMP is inside the support at every instant, not at samples only: a support
  is convex, and the end of a phase is always a sample. A double support of 5 ms is one interval.
- Footsteps are given, and with them the speed of walking. His cost is nearly all velocity and finds
  the feet; here the ZMP's part leads, and velocity and jerk shape the motion between the feet.
- He has no constraint at the end of the horizon. The one on ξ keeps the motion bounded by itself.

The DCM ξ = c + ċ/ω diverges from the ZMP, and η = c − ċ/ω converges to it. In each of the plane's
two directions the pendulum is ẋ = λ (x − p). For x = ξ it has λ = ω, and for x = η λ = −ω.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import ConfigError
from shared.motion.com_plan import ComPlan, ZmpSegment
from shared.wbc.qp import QpSolver, QpStatus, QuadraticProgram, make_solver

# A ZMP error at the end of the horizon reaches the present shrunk by e^{−ω · 1.6 s}, some 1/500.
PREVIEW = 1.6
# Longest interval inside a phase [s].
INTERVAL = 0.05
# Distance kept from the edge of the support [m].
MARGIN = 0.01

# γ = 1 is the unit. At this β [s²] the body sways some 7 % less than with the ZMP under the middle
# of the sole, from which it goes up to 1 cm; with 0.1 that is 3.5 cm, nearly to the edge.
VELOCITY_WEIGHT = 0.02
# α [s⁶] evens the ZMP out. With 1e-7 it would leave the middle of the sole by 3 cm on both sides of
# a double support of 5 ms, for a shorter way.
JERK_WEIGHT = 1e-8


@dataclass(frozen=True)
class SupportPhase:
    """A span of time [s] on the same soles, with the targets of the CoM in it.

    `corners` (k, 2) of the loaded soles in the world [m]; `zmp` (2,) target of the ZMP at the end,
    reached on a line from the target of the phase before [m]; `velocity` (2,) mean velocity of
    walking, without sway [m/s]; `ground` height of the ground under the ZMP at the end [m].
    """

    begin: float
    finish: float
    corners: np.ndarray
    zmp: np.ndarray
    velocity: np.ndarray
    ground: float = 0.0


def mpc_plan(phases: Sequence[SupportPhase], *, omega: float, position: np.ndarray) -> ComPlan:
    """Plan the motion from rest at `position` (2,) to rest at the last phase's `zmp`.

    Raise `ConfigError` if at some time no motion keeps the ZMP inside the support, or if the ground
    is not level.
    """
    if any(phase.ground != 0.0 for phase in phases):
        raise ConfigError(
            "walk.com_plan: expected dcm over ground that is not level, because the pendulum of "
            "mpc has a constant height, got 'mpc'"
        )
    samples = _samples(phases, position)
    times = [phases[0].begin, *(sample.time for sample in samples)]
    rest = phases[-1].zmp
    solver = make_solver("daqp")
    zmp = [position]
    xi = eta = position
    for k, time in enumerate(times):
        stop = bisect.bisect_left(times, time + PREVIEW - 1e-9)
        horizon = _Horizon(samples[k:stop], omega=omega, xi=xi, eta=eta, zmp=zmp[-1])
        ends = stop >= len(samples)
        ahead = horizon.solve(solver, rest=rest if ends else None)
        if ahead is None:
            raise ConfigError(
                f"walk: from {time:.2f} s on no motion of the CoM keeps the ZMP inside the "
                "support: use a longer begin_duration or double_support, shorter steps, or "
                'com_plan = "dcm", which does not look at the support'
            )
        if ends:  # a further horizon would end at the same place with the same result
            zmp.extend(ahead)
            break
        xi, eta = horizon.first_state(ahead)
        zmp.append(ahead[0])
    level = [np.append(point, 0.0) for point in zmp]
    segments = [
        ZmpSegment(times[k], times[k + 1], level[k], level[k + 1]) for k in range(len(samples))
    ]
    return ComPlan(
        segments,
        omega=omega,
        position=np.append(position, 0.0),
        capture_point=np.append(rest, 0.0),
    )


@dataclass(frozen=True)
class _Sample:
    """End of an interval of length `duration` [s]; the ZMP p there must obey normals p ≥ offsets.

    `weight` is the time the sample stands for, half of the intervals on its two sides [s].
    """

    time: float
    duration: float
    weight: float
    zmp: np.ndarray
    velocity: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray


def _samples(phases: Sequence[SupportPhase], position: np.ndarray) -> list[_Sample]:
    counts = [max(1, math.ceil((p.finish - p.begin) / INTERVAL - 1e-6)) for p in phases]
    durations = [(p.finish - p.begin) / n for p, n in zip(phases, counts, strict=True)]
    polygons = [_half_planes(phase.corners) for phase in phases]
    samples = []
    start = position
    for k, (phase, n, duration) in enumerate(zip(phases, counts, durations, strict=True)):
        for i in range(1, n + 1):
            here, following = [polygons[k]], duration
            if i == n:  # between two phases the ZMP must be inside both supports
                here += polygons[k + 1 : k + 2]
                following = durations[k + 1] if k + 1 < len(phases) else 0.0
            samples.append(
                _Sample(
                    time=phase.finish if i == n else phase.begin + i * duration,
                    duration=duration,
                    weight=(duration + following) / 2,
                    zmp=start + (phase.zmp - start) * (i / n),
                    velocity=phase.velocity,
                    normals=np.vstack([normals for normals, _ in here]),
                    offsets=np.concatenate([offsets for _, offsets in here]),
                )
            )
        start = phase.zmp
    return samples


def _half_planes(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inward normals (m, 2) and offsets (m,) of the hull of `corners`, shrunk by `MARGIN`."""
    # Imported here: it takes long, and only this plan needs it.
    from scipy.spatial import ConvexHull

    equations = ConvexHull(corners).equations
    return -equations[:, :2], equations[:, 2] + MARGIN


class _Horizon:
    """The quadratic program over N samples. Its unknowns are the ZMPs: N in x, then N in y.

    `xi`, `eta`, `zmp` (2,) are the state where the horizon begins.
    """

    def __init__(
        self,
        samples: Sequence[_Sample],
        *,
        omega: float,
        xi: np.ndarray,
        eta: np.ndarray,
        zmp: np.ndarray,
    ) -> None:
        self._samples = samples
        durations = np.array([sample.duration for sample in samples])
        n = len(samples)
        # At the samples ξ = xi_free + xi_map P and η likewise, with P (N, 2) the unknown ZMPs.
        self._xi_map, self._xi_free = _response(durations, omega, state=xi, zmp=zmp)
        self._eta_map, self._eta_free = _response(durations, -omega, state=eta, zmp=zmp)
        velocity_map = omega / 2 * (self._xi_map - self._eta_map)
        velocity_free = omega / 2 * (self._xi_free - self._eta_free)
        # c⃛ = ω² (ċ − ṗ) with the ZMP's slope in the interval that ends there.
        jerk_map = omega**2 * (velocity_map - (np.eye(n) - np.eye(n, k=-1)) / durations[:, None])
        jerk_free = omega**2 * velocity_free
        jerk_free[0] += omega**2 * zmp / durations[0]

        weights = np.array([sample.weight for sample in samples])
        jerk_cost = JERK_WEIGHT * jerk_map.T * durations
        velocity_cost = VELOCITY_WEIGHT * velocity_map.T * weights
        velocity_ref = np.array([sample.velocity for sample in samples])
        zmp_ref = np.array([sample.zmp for sample in samples])
        hessian = jerk_cost @ jerk_map + velocity_cost @ velocity_map + np.diag(weights)
        gradient = (
            jerk_cost @ jerk_free
            + velocity_cost @ (velocity_free - velocity_ref)
            - weights[:, None] * zmp_ref
        )
        self._H = np.kron(np.eye(2), hessian)
        self._g = gradient.T.ravel()

    def solve(self, solver: QpSolver, *, rest: np.ndarray | None) -> np.ndarray | None:
        """ZMPs at the samples (N, 2), coming to rest at `rest` if given; None if there are none."""
        n = len(self._samples)
        sample_of_row = np.repeat(np.arange(n), [len(s.offsets) for s in self._samples])
        normals = np.vstack([sample.normals for sample in self._samples])
        offsets = np.concatenate([sample.offsets for sample in self._samples])
        rows = np.eye(n)[sample_of_row]
        C = np.hstack([normals[:, :1] * rows, normals[:, 1:] * rows])
        if rest is None:
            last = self._samples[-1]
            problem = QuadraticProgram(
                self._H,
                self._g,
                C=np.vstack([C, np.kron(last.normals, self._xi_map[-1])]),
                l=np.concatenate([offsets, last.offsets - last.normals @ self._xi_free[-1]]),
            )
        else:
            ends = np.vstack([np.eye(n)[-1], self._xi_map[-1], self._eta_map[-1]])
            values = np.vstack([rest, rest - self._xi_free[-1], rest - self._eta_free[-1]])
            problem = QuadraticProgram(
                self._H, self._g, C, offsets, E=np.kron(np.eye(2), ends), e=values.T.ravel()
            )
        solution = solver.solve(problem)
        if solution.status is not QpStatus.SOLVED:
            return None
        return solution.x.reshape(2, n).T

    def first_state(self, zmp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ξ and η at the first sample, (2,) each, if the samples' ZMPs are `zmp` (N, 2)."""
        return (
            self._xi_free[0] + self._xi_map[0] @ zmp,
            self._eta_free[0] + self._eta_map[0] @ zmp,
        )


def _response(
    durations: np.ndarray, rate: float, *, state: np.ndarray, zmp: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solution of ẋ = rate (x − p) at the samples: x = free + map P.

    Returns map (N, N), lower triangular, and free (N, 2), the part of the `state` and `zmp` (2,) at
    the beginning. In an interval Δ with p linear from p₀ to p₁, x₁ = e x₀ + b₀ p₀ + b₁ p₁. Its
    coefficients are e = e^{rate Δ}, b₁ = 1 − (e − 1)/(rate Δ) and b₀ = 1 − e − b₁.
    """
    factor = np.exp(rate * durations)
    after = 1.0 - np.expm1(rate * durations) / (rate * durations)
    before = 1.0 - factor - after
    shift = np.eye(len(durations), k=-1)
    through = np.linalg.inv(np.eye(len(durations)) - factor[:, None] * shift)
    free = np.outer(through[:, 0], factor[0] * state + before[0] * zmp)
    return through @ (np.diag(after) + before[:, None] * shift), free
