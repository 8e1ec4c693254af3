"""Settings that follow from a robot's mass and geometry, by one rule for every robot.

The robot has mass m, a CoM at height h, and ω = √(g/h). A sole is 2 L long. The CoM is at distance
d from the outer edge of a foot. A leg reaches r.

* `wbc.weights.force` ω_f = 8 ρ (L / (m h))². A CoP that moves by δ costs ½ ω_f (m g / L)² δ²/8 in
  uneven forces of two soles. It costs ½ (g/h)² δ² in the acceleration of the CoM. ρ is the ratio.
  Near 1 the robot leans to load its feet evenly.
* `push` for 0.2 s moves the DCM by m⁻¹ω⁻¹ F 0.2 s, to the part `_PUSHED` of d.
* `walk.step_length` is the part `_STRIDE` of the legs' reach to both sides, 2 r.
* `walk.step_duration` is `_STEP`/ω, because the DCM diverges by e^{ωT} in a step.
* `wbc.gains.contact_damping` is a constant: half of the value at which Talos falls over 25 ms with
  LA, where a foot rolls from edge to edge on a stale active set. No rule for it is known.
* `wbc.weights.com` is 10 in a walk, a constant found with G1 and iCub, which fall with 1.
* `robot.torque_clamp` is 1, the URDF's own limits.

Gains are per unit of mass, and need no rule.
"""

from __future__ import annotations

import math
from typing import Any

import pinocchio as pin

from shared.robots.description import GRAVITY, Foot, Robot
from shared.robots.standing import leg_reach, placements

_RATIO = 0.1
_PUSHED = 0.8
_PUSH_SECONDS = 0.2
_STRIDE = 1.0 / 3.0
_STEP = 3.1
_CONTACT_DAMPING = 15.0
_COM_WEIGHT = 10.0


def derived_settings(robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the settings of a robot file by the rule, by task and dotted key."""
    com = pin.centerOfMass(robot.model, robot.model.createData(), robot.q_standing)
    height, omega = float(com[2]), math.sqrt(GRAVITY / float(com[2]))
    half_length = min(sole.x[1] - sole.x[0] for sole in robot.soles) / 2
    force = 8.0 * _RATIO * (half_length / (robot.mass * height)) ** 2
    push = _PUSHED * robot.mass * omega * _to_outer_edge(robot, float(com[1])) / _PUSH_SECONDS
    both = {
        "robot.torque_clamp": 1.0,
        "wbc.weights.force": float(f"{force:.2g}"),
        "wbc.gains.contact_damping": _CONTACT_DAMPING,
    }
    walk = {
        "wbc.weights.com": _COM_WEIGHT,
        "walk.step_length": math.floor(100.0 * _STRIDE * 2.0 * leg_reach(robot)) / 100.0,
        "walk.step_duration": round(_STEP / omega, 2),
    }
    return {
        "balance": {"push": [f"{push:.0f}N@1.0s:{_PUSH_SECONDS:g}s:+y"], **both},
        "walk": {**both, **walk},
    }


def _to_outer_edge(robot: Robot, com_y: float) -> float:
    """Distance of the CoM from the nearer outer edge of the feet [m]."""
    soles = {sole.side: sole for sole in robot.soles}
    at = placements(robot)
    left = at[Foot.LEFT].translation[1] + soles[Foot.LEFT].y[1]
    right = at[Foot.RIGHT].translation[1] + soles[Foot.RIGHT].y[0]
    return float(min(left - com_y, com_y - right))
