"""What is played for one cell and one seed of a study, one trial after the other.

In most studies it is a single trial; in a bisection each trial but the first, that at `high`,
depends on whether those before it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Literal

from shared.config.settings import RunConfig

Outcome = Literal["stood", "fell", "error"]
# The largest integer that stood and the smallest that fell, None if none did.
Bracket = tuple[int, int | None]


@dataclass(frozen=True)
class Trial:
    """One run of a seed of a cell. `label` is what varies.

    `identity` is a hash of all that it depends on but the code, which has a version of its own.
    With `all_active_sets`, states that the edge did not solve are solved after it.
    """

    cell: int
    label: dict[str, Any]
    config: RunConfig
    identity: str
    all_active_sets: bool = False


@dataclass(frozen=True)
class Bisection:
    """Between `low`, taken to stand, and `high`, where a cell's limit is for a seed.

    `values` are settings at an integer: text with {} for it, texts of which some have it, or a
    number that it multiplies. The first one, `setting`, is a column of the table.
    """

    values: dict[str, Any]
    low: int
    high: int
    resolution: int

    @property
    def setting(self) -> str:
        """What is bisected; the others follow it."""
        return next(iter(self.values))

    @property
    def max_trials(self) -> int:
        """So many trials at most."""
        trials, apart = 1, self.high - self.low
        while apart > self.resolution:
            trials, apart = trials + 1, (apart + 1) // 2
        return trials

    def settings(self, at: int) -> dict[str, Any]:
        """The settings at an integer."""
        return {key: _value(value, at) for key, value in self.values.items()}

    def search(self) -> Generator[int, bool, Bracket]:
        """Integers to play, one at a time; is sent whether that stood. Returns the bracket."""
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
    """What is played for a cell and a seed: the trials so far, and the next, None at the end.

    `bracket` is what a bisection came to, None before its end and where a trial ended in an error.
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
        """Go on as far as the outcome of trials is known."""
        while self.next is not None and (known := outcome(self.next)) is not None:
            self.played.append(self.next)
            self.next = None
            if known != "error":
                try:
                    self.next = self._trials.send(known == "stood")
                except StopIteration as end:
                    self.bracket = end.value


def outcome_of(error: str | None, summary: dict[str, Any] | None) -> Outcome:
    """What a trial came to, from the error that ended it or else its summary."""
    if error is not None or summary is None:
        return "error"
    return "fell" if summary["fell"] else "stood"


def _value(value: Any, at: int) -> Any:
    if isinstance(value, list):
        return [_value(each, at) for each in value]
    return value.replace("{}", str(at)) if isinstance(value, str) else value * at
