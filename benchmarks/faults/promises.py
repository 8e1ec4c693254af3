"""The promises of the project about faults, and the comparison of outcomes with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from benchmarks.faults import fuzz, lockstep
from benchmarks.faults.cases import FUZZ, KINDS, LIVE, LOCKSTEP, Case

Outcome = dict[str, Any]


@dataclass(frozen=True)
class Promise:
    """A promise in words. `asked` selects its cases, and `kept` tells by a case's outcome."""

    kind: str
    text: str
    kept: Callable[[Outcome], bool]
    asked: Callable[[Case], bool] = lambda case: True

    def applies(self, case: Case, outcome: Outcome) -> bool:
        """Return whether the case is evidence. A skipped case is not."""
        return case.kind == self.kind and "skipped" not in outcome and self.asked(case)


def _controlled(name: str) -> Callable[[Case], bool]:
    return lambda case: case.parameters.get("controller") == name


def _has(key: str) -> Callable[[Outcome], bool]:
    return lambda outcome: bool(outcome[key])


def _stands(outcome: Outcome) -> bool:
    return outcome["ended"] and not outcome["fell"]


PROMISES = (
    Promise(
        FUZZ,
        "A hostile message raises no error, and the robot stands",
        lambda outcome: outcome["sent"] and not outcome["fell"],
    ),
    Promise(
        FUZZ,
        "Every torque is finite and within the clamp, also in the tick of the hostile message",
        lambda outcome: outcome["finite"] and outcome["clamped"],
    ),
    Promise(
        FUZZ,
        "A second later no honest message is refused, and the same states are answered as without "
        "the hostile one",
        _has("answered_after"),
    ),
    Promise(
        FUZZ,
        f"A second later every torque is within {fuzz.TOLERANCE:g} N m of the torque without it "
        f"({fuzz.LC_TOLERANCE:g} N m for LC with another factorisation, any after a plan "
        "that fits)",
        lambda outcome: (
            outcome["plan_taken"] or outcome["torque_apart_after"] <= outcome["torque_tolerance"]
        ),
    ),
    Promise(
        FUZZ,
        "Open rows that are not the robot's own change no torque",
        _has("equal"),
        lambda case: case.parameters["to"] == fuzz.OPEN,
    ),
    Promise(
        LOCKSTEP,
        "LC never falls and never hangs",
        _stands,
        _controlled("lc"),
    ),
    Promise(
        LOCKSTEP,
        "LA never falls in an outage of at most 0.4 s outside a push",
        _stands,
        lambda case: case.fault == "outage" and _controlled("la")(case),
    ),
    Promise(
        LOCKSTEP,
        "LA stands after repeated joint holds, and goes on with new answers",
        _stands,
        lambda case: case.fault == "repeated holds" and _controlled("la")(case),
    ),
    Promise(
        LOCKSTEP,
        "Neither LA nor LC falls when the base's estimate jumps or drifts",
        _stands,
        lambda case: case.fault in lockstep.LATER_DRAWS and not _controlled("pr")(case),
    ),
    Promise(
        LOCKSTEP,
        "Every torque is finite and within the clamp, for PR, LA and LC",
        lambda outcome: outcome["finite"] and outcome["clamped"],
    ),
    Promise(
        LOCKSTEP, "Every trial ends, at its duration or with a fall that it reports", _has("ended")
    ),
    Promise(
        LOCKSTEP,
        "The same fault gives the same trial to the last bit",
        _has("same_again"),
        lockstep.is_played_twice,
    ),
    Promise(
        LIVE, "`stack/state` agrees with the processes, during a run and after it", _has("agrees")
    ),
    Promise(LIVE, "Every summary and every Parquet file can be read", _has("readable")),
    Promise(LIVE, "No process and no lock is left", _has("clean")),
    Promise(LIVE, "An error is one line, and there is no traceback", _has("one_line")),
    Promise(
        LIVE, "The outcome is told: the exit code and the summary say what happened", _has("told")
    ),
)


def broken(case: Case, outcome: Outcome | None) -> list[str]:
    """Return the promises that an outcome breaks; None, an error, breaks all of the kind."""
    return [
        promise.text
        for promise in PROMISES
        if case.kind == promise.kind
        and (outcome is None or (promise.applies(case, outcome) and not promise.kept(outcome)))
    ]


def table(played: Iterable[tuple[Case, Outcome | None]]) -> list[str]:
    """Return a Markdown table: each promise, its cases, and the cases that break it."""
    played = list(played)
    lines = ["| | promise | cases | kept | broken by |", "|---|---|---:|---:|---|"]
    for promise in sorted(PROMISES, key=lambda each: KINDS.index(each.kind)):
        cases = [
            (case, outcome)
            for case, outcome in played
            if case.kind == promise.kind
            and (promise.asked(case) if outcome is None else promise.applies(case, outcome))
        ]
        failed = [
            case.name for case, outcome in cases if outcome is None or not promise.kept(outcome)
        ]
        names = ", ".join(f"`{name}`" for name in failed) or "–"
        counts = f"{len(cases)} | {len(cases) - len(failed)}"
        lines.append(f"| {promise.kind} | {promise.text} | {counts} | {names} |")
    return lines
