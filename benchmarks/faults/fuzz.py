"""One hostile message and then a second of honest ones, beside a twin without the hostile message.

The twin is the same robot and edge with the same sensor noise. At the end of the second, the edge
has to answer the same states as the twin's, and the torques have to equal the twin's.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.faults.cases import Case, Draw, Parameters
from benchmarks.faults.hostile import TO_EDGE, TO_OPEN_ROWS, TO_ROBOT, Change, Drawn
from benchmarks.faults.hostile_plans import TO_LAW, TO_PLANS, is_law
from benchmarks.faults.pair import Arrive, Pair, unchanged
from shared.config.config_file import load_config
from shared.motion.step_law import StepLaw
from shared.wire.plans import PlanCodec, law_identity

EDGE, ROBOT, PLANS, LAW, OPEN = "edge", "robot", "plans", "law", "open"
# The last ticks of a case, which are compared.
_COMPARED = 100
# A torque may differ from the twin's by this [N m]: an answer that is accepted, and then replaced,
# moves a robot a little, which its feedback takes back.
TOLERANCE = 0.5
# LC asks for a factorisation when it needs one. It may then hold another one than its twin, which
# is as honest, and corrects from there.
LC_TOLERANCE = 5.0
# A robot that follows a plan, by touch, with its own limits.
WALK: Parameters = {
    "task": "walk",
    "walk.steps": 3,
    "walk.begin_duration": 0.5,
    "walk.step_duration": 0.5,
    "stepping.mode": "on",
    "correction.on_board_budget": 0.0,
    "plant.joint_limits": True,
    "plant.leg_collision": True,
}
# A robot with its own limits, which a push makes it reach.
LIMITED: Parameters = {
    "wbc.limits.torque": True,
    "wbc.limits.position": True,
    "push": ["100N@0.02s:0.2s:+y"],
}
# Controllers, and whether an answer to every state is asked for. LC takes two turns in four: with
# an answer to every state, and as it is.
_TURNS = (("la", False), ("lc", True), ("pr", False), ("lc", False))


@dataclass(frozen=True)
class _Target:
    """A way into robot or edge.

    A fault's name ends with `name`, and `way` is the argument of `Pair.tick`. The hostile message
    comes in the tick `at` or with the next honest message of its kind, and the case lasts for
    `honest` ticks after `at`.
    """

    name: str
    changes: dict[str, tuple[Drawn, Change]]
    way: str
    at: tuple[int, ...]
    honest: int
    settings: Parameters
    turns: tuple[tuple[str, bool], ...] = _TURNS

    @property
    def ticks(self) -> int:
        return max(self.at) + self.honest


# The first 100 ms of a session have another rule at the edge.
_TARGETS = {
    EDGE: _Target("to the edge", TO_EDGE, "uplink", (20, 150), 1000, {}),
    ROBOT: _Target("to the robot", TO_ROBOT, "downlink", (20, 150), 1000, {}),
    PLANS: _Target("of a plan", TO_PLANS, "plans", (0, 400, 900), 1500, WALK),
    LAW: _Target("of a step law", TO_LAW, "plans", (0,), 2400, WALK),
    OPEN: _Target(
        "of open rows", TO_OPEN_ROWS, "downlink", (110, 250), 1000, LIMITED, turns=(("la", False),)
    ),
}


def play(case: Case) -> dict[str, Any]:
    """Play a case, and return what it showed."""
    given = case.parameters
    target = _TARGETS[given["to"]]
    honest = _twin(case.seed, given["to"], given["controller"], given["every_state"])
    pair = _pair(case.seed, given["to"], given["controller"], given["every_state"])
    strike = _Strike(case, pair)
    refused_before = 0
    last_tick = given["at"] + target.honest
    for tick in range(last_tick):
        # An edge does not answer every state of LC: its next answer is the one that is changed.
        hostile: Arrive = strike if tick >= given["at"] else unchanged
        if tick == last_tick - _COMPARED:
            refused_before = _refused(pair)
        pair.tick(**{target.way: hostile})
        strike.end_tick()
    tau, ages = pair.column("tau"), pair.column("projector_age_ns")
    n = len(tau)
    apart = np.abs(tau - honest["tau"][:n]).max(axis=1)
    last = slice(n - _COMPARED, n)
    same_age = np.array_equal(ages[last], honest["projector_age_ns"][:n][last])
    as_needed = given["controller"] == "lc" and not given["every_state"]
    plans = pair.robot.plans
    return {
        "sent": strike.done,
        "fell": pair.robot.fallen,
        "finite": bool(np.isfinite(tau).all()),
        "clamped": bool(np.all(np.abs(tau) <= pair.limit + 1e-12)),
        "torque_apart": float(apart.max()),
        "torque_apart_after": float(apart[last].max()),
        "torque_tolerance": LC_TOLERANCE if as_needed else TOLERANCE,
        "plan_taken": strike.plan_taken,
        "answered_after": (same_age or as_needed or strike.plan_taken)
        and _refused(pair) == refused_before,
        "equal": bool(apart.max() == 0.0),
        "refused": {
            EDGE: dict(pair.edge.refused),
            ROBOT: dict(pair.robot.cache.refused),
            **({} if plans is None else {PLANS: dict(plans.refused)}),
        },
    }


class _Strike:
    """Puts the hostile message beside the first honest one of its kind.

    `plan_taken` tells that the robot follows a hostile plan or law after that tick.
    """

    def __init__(self, case: Case, pair: Pair) -> None:
        self.done = self.plan_taken = False
        self._given = case.parameters
        self._rng = case.rng()
        self._pair = pair
        self._of_plans = self._given["to"] in (PLANS, LAW)
        self._honest: bytes | None = None

    def __call__(self, data: bytes) -> list[bytes]:
        given = self._given
        if self.done or (self._of_plans and is_law(data) != (given["to"] == LAW)):
            return [data]
        self.done, self._honest = True, data
        _, change = _TARGETS[given["to"]].changes[given["change"]]
        wrong = change(data, self._pair.codec, given, self._rng)
        hostile = wrong if isinstance(wrong, list) else [wrong]
        return [*hostile, data] if given["first"] else [data, *hostile]

    def end_tick(self) -> None:
        """Look at what the robot has taken in the tick of the hostile message."""
        if self._honest is None or not self._of_plans:
            return
        robot, content = self._pair.robot, PlanCodec(self._pair.codec).decode(self._honest).content
        self._honest = None
        assert robot.plans is not None
        assert robot.clock is not None
        if isinstance(content, StepLaw):
            self.plan_taken = robot.plans.law != law_identity(content)
        else:
            self.plan_taken = robot.clock.plan != content


def _pair(seed: int, to: str, controller: str, every_state: bool) -> Pair:
    settings: Parameters = {"seed": seed, "controller": controller, "push": []}
    if every_state:
        settings |= {"correction.refresh_distance": 0.0, "correction.refresh_interval_ns": 0}
    return Pair(load_config(None, settings | _TARGETS[to].settings))


@functools.cache
def _twin(seed: int, to: str, controller: str, every_state: bool) -> dict[str, np.ndarray]:
    """Return the columns of an undisturbed pair."""
    pair = _pair(seed, to, controller, every_state)
    for _ in range(_TARGETS[to].ticks):
        pair.tick()
    return {name: pair.column(name) for name in ("tau", "projector_age_ns")}


def _refused(pair: Pair) -> int:
    return pair.edge.refused.total() + pair.robot.refused.total()


def _draw(to: str, change: str) -> Draw:
    draw, _ = _TARGETS[to].changes[change]
    at, turns = _TARGETS[to].at, _TARGETS[to].turns

    def parameters(turn: int, rng: np.random.Generator) -> Parameters:
        controller, every_state = turns[(turn + int(rng.integers(len(turns)))) % len(turns)]
        return {
            "to": to,
            "change": change,
            "controller": controller,
            "every_state": every_state,
            "at": at[int(rng.integers(len(at)))],
            "first": bool(rng.integers(2)),
            **draw(rng),
        }

    return parameters


DRAWS: dict[str, Draw] = {
    f"{change} {target.name}": _draw(to, change)
    for to, target in _TARGETS.items()
    for change in target.changes
}
