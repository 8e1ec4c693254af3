"""The cases of a campaign, made from its seed.

The faults of a kind take turns, so that the first cases of a kind hold every fault. The short
campaign consists of the first cases of the whole one, with the same names and parameters.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from shared.errors import ConfigError, one_of

FUZZ, LOCKSTEP, LIVE = KINDS = ("fuzz", "lockstep", "live")
# The number of cases of each kind: of the whole campaign, and of the short one.
WHOLE = {FUZZ: 300, LOCKSTEP: 356, LIVE: 64}
SHORT = {FUZZ: 36, LOCKSTEP: 16, LIVE: 1}
# Faults that came later begin at this number, so that every earlier case keeps its number. The
# short campaign has the first case of each.
LATER = {LOCKSTEP: 320}

Parameters = dict[str, Any]
Draw = Callable[[int, np.random.Generator], Parameters]


# Cases are keys: their parameters cannot be compared by a hash.
@dataclass(frozen=True, eq=False)
class Case:
    """One fault. `seed` is the campaign's, `number` counts the cases of the kind from 0."""

    kind: str
    number: int
    seed: int
    fault: str
    parameters: Parameters

    @property
    def name(self) -> str:
        """The name of the case within its campaign: `lockstep-017`."""
        return f"{self.kind}-{self.number:03d}"

    @property
    def label(self) -> dict[str, Any]:
        """The case in the journal."""
        return {
            "case": self.name,
            "seed": self.seed,
            "kind": self.kind,
            "fault": self.fault,
            "parameters": self.parameters,
        }

    @property
    def identity(self) -> str:
        """A hash of everything that the case depends on except the code."""
        text = json.dumps(self.label, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def rng(self) -> np.random.Generator:
        """Return the random numbers of the case, always the same ones."""
        return np.random.default_rng([self.seed, KINDS.index(self.kind), self.number, 1])


def make_cases(
    kind: str,
    draws: dict[str, Draw],
    *,
    later: dict[str, Draw] | None = None,
    seed: int,
    count: int | None = None,
) -> list[Case]:
    """Return the first `count` cases of a kind, by default those of the whole campaign.

    `draws` has for each fault a function from a case's number within that fault to its parameters,
    and `later` has those of the faults that came later.
    """
    cases = []
    for number in range(WHOLE[kind] if count is None else count):
        series, turn = draws, number
        if later and number >= LATER[kind]:
            series, turn = later, number - LATER[kind]
        faults = list(series)
        fault = faults[turn % len(faults)]
        rng = np.random.default_rng([seed, KINDS.index(kind), number, 0])
        parameters = series[fault](turn // len(faults), rng)
        cases.append(Case(kind, number, seed, fault, parameters))
    return cases


def select(cases: Iterable[Case], names: list[str]) -> list[Case]:
    """Return the cases with these names; raise `ConfigError` for a name that no case has."""
    by_name = {case.name: case for case in cases}
    for name in names:
        if name not in by_name:
            given = {case.kind: case.name for case in by_name.values()}
            raise ConfigError(f"--only: {one_of(given.values(), name)}, or a number before it")
    return [by_name[name] for name in names]
