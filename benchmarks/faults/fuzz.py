"""One hostile message, then a second of honest ones, beside a twin that never met it.

The twin is the same robot and edge with the same sensor noise. At the end of the second, the edge
has to answer the same states as the twin's, and the torques have to equal the twin's.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from benchmarks.faults.cases import Case, Draw, Parameters
from benchmarks.faults.hostile import TO_EDGE, TO_ROBOT
from benchmarks.faults.pair import Arrive, Pair, unchanged
from shared.config.config_file import load_config

EDGE, ROBOT = "edge", "robot"
# Ticks of honest messages after the hostile one, and the last of them, which are compared.
_HONEST, _COMPARED = 1000, 100
# The tick of the hostile message: in the edge's first 100 ms of a session, or after.
_AT = (20, 150)
# A torque may differ from the twin's by this [N m]: an answer that is accepted, and then replaced,
# moves a robot a little, which its feedback takes back.
TOLERANCE = 0.5
# LC asks for a factorisation when it needs one. It may then hold another one than its twin, which
# is as honest, and corrects from there.
LC_TOLERANCE = 5.0


def play(case: Case) -> dict[str, Any]:
    """Play a case, and return what it showed."""
    given = case.parameters
    honest = _twin(case.seed, given["controller"], given["every_state"])
    rng = case.rng()
    pair = _pair(case.seed, given["controller"], given["every_state"])
    _, change = (TO_EDGE if given["to"] == EDGE else TO_ROBOT)[given["change"]]
    sent = False

    def hostile(data: bytes) -> list[bytes]:
        nonlocal sent
        if sent:
            return [data]
        sent = True
        wrong = change(data, pair.codec, given, rng)
        return [wrong, data] if given["first"] else [data, wrong]

    refused_before = 0
    for tick in range(given["at"] + _HONEST):
        # An edge does not answer every state of LC: its next answer is the one that is changed.
        strike: Arrive = hostile if tick >= given["at"] else unchanged
        if tick == given["at"] + _HONEST - _COMPARED:
            refused_before = _refused(pair)
        pair.tick(**{"uplink" if given["to"] == EDGE else "downlink": strike})
    tau, ages = pair.column("tau"), pair.column("projector_age_ns")
    n = len(tau)
    apart = np.abs(tau - honest["tau"][:n]).max(axis=1)
    last = slice(n - _COMPARED, n)
    same_age = np.array_equal(ages[last], honest["projector_age_ns"][:n][last])
    as_needed = given["controller"] == "lc" and not given["every_state"]
    return {
        "sent": sent,
        "fell": pair.robot.fallen,
        "finite": bool(np.isfinite(tau).all()),
        "clamped": bool(np.all(np.abs(tau) <= pair.limit + 1e-12)),
        "torque_apart": float(apart.max()),
        "torque_apart_after": float(apart[last].max()),
        "torque_tolerance": LC_TOLERANCE if as_needed else TOLERANCE,
        "answered_after": (same_age or as_needed) and _refused(pair) == refused_before,
        "equal": bool(apart.max() == 0.0),
        "refused": {
            EDGE: dict(pair.edge.refused),
            ROBOT: dict(pair.robot.cache.refused),
        },
    }


def _pair(seed: int, controller: str, every_state: bool) -> Pair:
    settings: Parameters = {"seed": seed, "controller": controller, "push": []}
    if every_state:
        settings |= {"correction.refresh_distance": 0.0, "correction.refresh_interval_ns": 0}
    return Pair(load_config(None, settings))


@functools.cache
def _twin(seed: int, controller: str, every_state: bool) -> dict[str, np.ndarray]:
    """Return the columns of an undisturbed pair."""
    pair = _pair(seed, controller, every_state)
    for _ in range(max(_AT) + _HONEST):
        pair.tick()
    return {name: pair.column(name) for name in ("tau", "projector_age_ns")}


def _refused(pair: Pair) -> int:
    return pair.edge.refused.total() + pair.robot.cache.refused.total()


def _draw(to: str, change: str) -> Draw:
    draw, _ = (TO_EDGE if to == EDGE else TO_ROBOT)[change]

    def parameters(turn: int, rng: np.random.Generator) -> Parameters:
        # LC takes two turns in four: with an answer to every state, and as it is.
        controller, every_state = (("la", False), ("lc", True), ("pr", False), ("lc", False))[
            (turn + int(rng.integers(4))) % 4
        ]
        return {
            "to": to,
            "change": change,
            "controller": controller,
            "every_state": every_state,
            "at": _AT[int(rng.integers(len(_AT)))],
            "first": bool(rng.integers(2)),
            **draw(rng),
        }

    return parameters


DRAWS: dict[str, Draw] = {
    f"{change} to the {to}": _draw(to, change)
    for to, changes in ((EDGE, TO_EDGE), (ROBOT, TO_ROBOT))
    for change in changes
}
