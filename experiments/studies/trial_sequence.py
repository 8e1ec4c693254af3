"""Sequence of trials for one cell and one seed of a study.

In most studies it has a single trial. In a bisection the first trial is at `high`. Each later trial
depends on the outcomes of the trials before it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Literal

from shared.config.settings import RunConfig

Outcome = Literal["stood", "fell", "error"]
# The largest integer at which the robot stood and the smallest at which it fell, None if it never
# fell.
Bracket = tuple[int, int | None]


@dataclass(frozen=True)
class Trial:
    """One trial of a cell and a seed. `label` has the settings that vary in the study.

    `identity` is a hash of everything that the trial depends on except the code. With
    `all_active_sets`, states that the edge did not solve are solved after it.
    """

    cell: int
    label: dict[str, Any]
    config: RunConfig
    identity: str
    all_active_sets: bool = False


@dataclass(frozen=True)
class Bisection:
    """A search for a limit between `low`, which is assumed to stand, and `high`.

    `values` are settings as a function of the integer: a text with {}, a list of texts of which at
    least one has {}, or a number that is multiplied by the integer. The first one, `setting`, is a
    column of the table.
    """

    values: dict[str, Any]
    low: int
    high: int
    resolution: int

    @property
    def setting(self) -> str:
        """The bisected setting, which the other settings follow."""
        return next(iter(self.values))

    @property
    def max_trials(self) -> int:
        """The maximum number of trials."""
        trials, apart = 1, self.high - self.low
        while apart > self.resolution:
            trials, apart = trials + 1, (apart + 1) // 2
        return trials

    def settings(self, at: int) -> dict[str, Any]:
        """The settings at an integer."""
        return {key: _value(value, at) for key, value in self.values.items()}

    def search(self) -> Generator[int, bool, Bracket]:
        """Yield integers to play and receive whether each stood. Return the bracket."""
        if (yield self.high):
            return self.high, None
        standing, falling = self.low, self.high
        while falling - standing > self.resolution:
            middle = (standing + falling) // 2
            if (yield middle):
                standing = middle
            else:
                falling = middle
        return standing, falling


class TrialSequence:
    """The trials of a cell and a seed: those played, and the next, None at the end.

    `bracket` is the result of a bisection. It is None before the end, and if a trial ended with an
    error.
    """

    def __init__(
        self, cell: int, seed: int, trials: Generator[Trial, bool, Bracket | None]
    ) -> None:
        self.cell, self.seed = cell, seed
        self.played: list[Trial] = []
        self.bracket: Bracket | None = None
        self._trials = trials
        self.next: Trial | None = next(trials)

    def follow(self, outcome: Callable[[Trial], Outcome | None]) -> None:
        """Advance to the first trial without a known outcome."""
        while self.next is not None and (known := outcome(self.next)) is not None:
            self.played.append(self.next)
            self.next = None
            if known != "error":
                try:
                    self.next = self._trials.send(known == "stood")
                except StopIteration as end:
                    self.bracket = end.value


def outcome_of(error: str | None, summary: dict[str, Any] | None) -> Outcome:
    """The outcome of a trial, from the error that ended it or else from its summary."""
    if error is not None or summary is None:
        return "error"
    return "fell" if summary["fell"] else "stood"


def _value(value: Any, at: int) -> Any:
    if isinstance(value, list):
        return [_value(each, at) for each in value]
    return value.replace("{}", str(at)) if isinstance(value, str) else value * at
