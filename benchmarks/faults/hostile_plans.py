"""Hostile plans and step laws: honest ones, changed so that they are malformed or fit no robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np

from benchmarks.faults.cases import Parameters
from benchmarks.faults.hostile import ANY, HUGE, Change, Drawn, choose
from shared.motion.footprint import Footprint
from shared.motion.planned import Plan, PlannedPhase
from shared.motion.step_law import NoGo, StepLaw
from shared.wire.codec import Codec
from shared.wire.messages import PlanMessage
from shared.wire.plans import PlanCodec

# Damaged messages of a case: all of them come in one tick.
_DAMAGED = 10_000


def is_law(data: bytes) -> bool:
    """Return whether a message has a step law, and not a plan."""
    return bool(msgpack.unpackb(data)["kind"] == "step_law")


def _changed(
    change: Callable[[PlanMessage, Any, np.random.Generator], PlanMessage],
) -> Change:
    """Change an honest message. One that comes after it has the next number."""

    def changed(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
        plans = PlanCodec(codec)
        message = plans.decode(data)
        if isinstance(message.content, Plan) and not given["first"]:
            number = message.content.number + 1
            message = dataclasses.replace(
                message, content=dataclasses.replace(message.content, number=number)
            )
        with np.errstate(all="ignore"):
            return plans.encode(change(message, given["by"], rng))

    return changed


def _plan(change: Callable[[Plan, Any, np.random.Generator], dict[str, Any]]) -> Change:
    def changed(message: PlanMessage, by: Any, rng: np.random.Generator) -> PlanMessage:
        plan = message.content
        assert isinstance(plan, Plan)
        content = dataclasses.replace(plan, **change(plan, by, rng))
        return dataclasses.replace(message, content=content)

    return _changed(changed)


def _phases(
    change: Callable[[PlannedPhase, Any, np.random.Generator], dict[str, Any]],
) -> Change:
    """Change every phase of a plan."""
    return _plan(
        lambda plan, by, rng: {
            "phases": tuple(
                dataclasses.replace(each, **change(each, by, rng)) for each in plan.phases
            )
        }
    )


def _order(message: PlanMessage, by: Any, rng: np.random.Generator) -> PlanMessage:
    """Change one of the numbers that put messages and phases in order."""
    del rng
    (name, value), plan = by, message.content
    assert isinstance(plan, Plan)
    if name in ("session", "sequence", "stamp_ns"):
        fields: dict[str, Any] = {name: min(getattr(message, name) + value, HUGE)}
        return dataclasses.replace(message, **fields)
    if name == "phase":
        origin = dataclasses.replace(plan.origin, phase=plan.origin.phase + value)
        content = dataclasses.replace(plan, origin=origin)
    elif name == "number":
        content = dataclasses.replace(plan, number=min(plan.number + value, HUGE))
    else:
        content = dataclasses.replace(plan, valid_until_ns=value)
    return dataclasses.replace(message, content=content)


def _footprint(phase: PlannedPhase, by: float, rng: np.random.Generator) -> dict[str, Any]:
    goal = phase.footprint
    if goal is None:
        return {}
    dx, dy, turn, dz = (by * rng.uniform(-1.0, 1.0, 4)).tolist()
    moved = Footprint(goal.foot, goal.x + dx, goal.y + dy, goal.yaw + turn, goal.z + dz)
    return {"footprint": moved}


def _duration(phase: PlannedPhase, by: float, rng: np.random.Generator) -> dict[str, Any]:
    del rng
    # Each phase begins where the one before ends: only durations are sent.
    lasts_ns = max(1, round(by * (phase.end_ns - phase.begin_ns)))
    return {"begin_ns": 0, "end_ns": min(lasts_ns, 59_000_000_000)}


def _points(phase: PlannedPhase, by: float, rng: np.random.Generator) -> dict[str, Any]:
    cop, dcm = (by * rng.uniform(-1.0, 1.0, (2, 2))).tolist()
    return {
        "cop": (phase.cop[0] + cop[0], phase.cop[1] + cop[1]),
        "dcm": (phase.dcm[0] + dcm[0], phase.dcm[1] + dcm[1]),
    }


def _law(*names: str) -> Change:
    """Scale one of the arrays of a step law."""

    def changed(message: PlanMessage, by: float, rng: np.random.Generator) -> PlanMessage:
        law = message.content
        assert isinstance(law, StepLaw)
        name = names[int(rng.integers(len(names)))]
        content = dataclasses.replace(law, **{name: by * getattr(law, name)})
        return dataclasses.replace(message, content=content)

    return _changed(changed)


def _boxes(message: PlanMessage, by: float, rng: np.random.Generator) -> PlanMessage:
    """Forbid every foothold within a distance [m] of the origin."""
    del rng
    assert isinstance(message.content, StepLaw)
    content = dataclasses.replace(message.content, no_go=(NoGo((-by, by), (-by, by)),))
    return dataclasses.replace(message, content=content)


def _damaged(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> list[bytes]:
    """Return copies of a message, each of them damaged in one of the ways of `ANY`."""
    ways = [*ANY.values()]
    messages: list[bytes] = []
    for _ in range(given["by"]):
        draw, change = ways[int(rng.integers(len(ways)))]
        wrong = change(data, codec, {**given, **draw(rng)}, rng)
        messages += wrong if isinstance(wrong, list) else [wrong]
    return messages


# By fault: how its parameter is drawn, and the change of an honest message.
TO_PLANS: dict[str, tuple[Drawn, Change]] = {
    "order": (
        choose(
            *(("number", value) for value in (1, 3000, HUGE)),
            *(("phase", value) for value in (1, -1, 7)),
            *(("valid_until_ns", value) for value in (0, HUGE)),
            *(("stamp_ns", value) for value in (1, HUGE)),
            *(("sequence", value) for value in (1, HUGE)),
            ("session", 1),
        ),
        _changed(_order),
    ),
    "footprints": (choose(0.02, 0.05, 0.1, 0.5, 1e6, float("nan")), _phases(_footprint)),
    "durations": (choose(1e-9, 0.1, 0.5, 2.0, 100.0), _phases(_duration)),
    "points": (choose(0.03, 0.1, 0.5, 1e6, float("nan")), _phases(_points)),
    "height": (
        choose(-0.1, 0.0, 0.02, 0.25, 1e3, float("nan")),
        _plan(lambda plan, by, rng: {"swing_height": by}),
    ),
    "damage": (choose(_DAMAGED), _damaged),
}
TO_LAW: dict[str, tuple[Drawn, Change]] = {
    "grids": (
        choose(0.5, 0.9, 1.1, 1e6),
        _law(
            *("footholds_x", "footholds_y", "cops_x", "cops_y", "cop_nominal", "times", "offsets")
        ),
    ),
    "boxes": (choose(0.1, 9.0), _changed(_boxes)),
    "values": (
        choose(0.0, -1.0, 0.5, 1.1, 1.9, 100.0),
        _law("values_x", "values_y", "going_on_x", "going_on_y"),
    ),
}
