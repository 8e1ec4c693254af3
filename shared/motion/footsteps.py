"""Footstep plan: a sequence of footprints from a few numbers, checked before anything moves.

The path advances by (length, sideways, turn) in its own frame with every step but the last, which
brings the feet together again. The leading foot is the one on the side that the path goes to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from shared.config.step_settings import WalkConfig
from shared.errors import ConfigError
from shared.motion.footprint import Footprint
from shared.robots import Foot, Robot
from shared.robots.standing import leg_reach
from shared.wbc.model import WholeBodyModel

# Soles that come closer than this side by side would touch [m].
SOLE_CLEARANCE = 0.01
MAX_TURN = math.radians(35.0)


@dataclass(frozen=True)
class Step:
    """One step: the swing foot goes from one footprint to another beside the support foot.

    `highest` is the highest ground under its path [m]. It matters only above both footprints.
    """

    support: Footprint
    start: Footprint
    goal: Footprint
    highest: float = -math.inf

    @property
    def swing_foot(self) -> Foot:
        return self.start.foot

    @property
    def obstacle(self) -> float:
        """Height of the ground under the path above the higher one of the footprints [m]."""
        return max(0.0, self.highest - max(self.start.z, self.goal.z))


def standing_footprints(robot: Robot) -> dict[Foot, Footprint]:
    """Footprints of the soles in the standing configuration."""
    placements = WholeBodyModel(robot).sole_placements(robot.q_standing)
    return {
        foot: Footprint(foot, float(M.translation[0]), float(M.translation[1]), 0.0)
        for foot, M in placements.items()
    }


def plan_footsteps(robot: Robot, config: WalkConfig) -> tuple[Step, ...]:
    """Plan the steps of a walk. Raise `ConfigError` with the reason if it cannot be walked."""
    feet = standing_footprints(robot)
    left, right = feet[Foot.LEFT], feet[Foot.RIGHT]
    width = config.step_width or left.y - right.y
    x, y, yaw = (left.x + right.x) / 2, (left.y + right.y) / 2, 0.0
    side = config.step_sideways if config.step_sideways else config.step_turn
    swing = Foot.RIGHT if side < 0 else Foot.LEFT
    steps = []
    for k in range(config.steps):
        if k < config.steps - 1 or config.steps == 1:
            c, s = math.cos(yaw), math.sin(yaw)
            x += c * config.step_length - s * config.step_sideways
            y += s * config.step_length + c * config.step_sideways
            yaw += config.step_turn
        offset = width / 2 if swing is Foot.LEFT else -width / 2
        goal = Footprint(swing, x - math.sin(yaw) * offset, y + math.cos(yaw) * offset, yaw)
        support_foot = Foot.RIGHT if swing is Foot.LEFT else Foot.LEFT
        step = Step(support=feet[support_foot], start=feet[swing], goal=goal)
        _check(robot, step, number=k + 1, lowering=config.com_lowering)
        steps.append(step)
        feet[swing] = goal
        swing = support_foot
    return tuple(steps)


def _check(robot: Robot, step: Step, *, number: int, lowering: float) -> None:
    """Check that a step stays within the leg's reach, does not cross the feet and does not turn too
    far.
    """
    support, goal = step.support, step.goal
    dx, dy = goal.position - support.position
    c, s = math.cos(support.yaw), math.sin(support.yaw)
    forward, lateral = c * dx + s * dy, -s * dx + c * dy
    if goal.foot is Foot.RIGHT:
        lateral = -lateral
    turn = abs(_wrapped(goal.yaw - support.yaw))
    if turn > MAX_TURN:
        raise ConfigError(
            f"walk: step {number} turns the foot by {math.degrees(turn):.0f}° against the other; "
            f"at most {math.degrees(MAX_TURN):.0f}° can be walked: use a smaller step_turn"
        )
    least = narrowest(robot, turn=turn) + SOLE_CLEARANCE
    if lateral < least:
        raise ConfigError(
            f"walk: step {number} puts the {goal.foot.value} foot {lateral:.3f} m to its side of "
            f"the other; less than {least:.3f} m and the feet would cross or touch: use a "
            "larger step_width or a smaller step_sideways"
        )
    reach = leg_reach(robot, raised=-lowering)
    # The hips are above the middle of the stance, so each leg spans half of a step while both feet
    # are down.
    stance = standing_footprints(robot)
    natural = stance[Foot.LEFT].y - stance[Foot.RIGHT].y
    distance = math.hypot(forward, lateral - natural) / 2
    if distance > reach:
        raise ConfigError(
            f"walk: step {number} goes {2 * distance:.2f} m from the support foot; the legs reach "
            f"{2 * reach:.2f} m at this height: use a smaller step_length or step_sideways"
        )


def narrowest(robot: Robot, *, turn: float) -> float:
    """Least distance of the sole origins side by side at which turned soles stay apart [m]."""
    soles = {sole.side: sole for sole in robot.soles}
    left_inner, right_inner = -soles[Foot.LEFT].y[0], soles[Foot.RIGHT].y[1]
    length = max(abs(x) for x in soles[Foot.LEFT].x)
    return left_inner + right_inner * math.cos(turn) + length * math.sin(turn)


def _wrapped(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
