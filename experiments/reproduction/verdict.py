"""The verdict on our number beside the paper's: same or better, same ordering, or differs.

RULE is the rule in words; `docs/results.md` prints it.
"""

from __future__ import annotations

import math
from enum import Enum

from experiments.reproduction.outcome import Outcome

# A part of the paper's number, and half of the last digit that the paper prints.
RELATIVE_TOLERANCE = 0.05
ROUNDING = 0.005
# Projectors cross the link as float32, so errors of equal commands differ by this at most.
EQUAL = 1e-6

RULE = f"""\
Every number of the paper has a verdict. A trial stands or falls. An error is the mean over the
trials that stood, and ∞ if all fell.

* **same or better**: the part of our trials that stood is at least the paper's. In Table IV the
  paper's part is its success rate. For an error over a constant delay it is all trials. Our error
  is at most {1 + RELATIVE_TOLERANCE:g} × the paper's plus {ROUNDING:g}, half of the paper's last
  digit. Where the paper has ∞, every outcome is *same or better*.
* **same ordering**: the number is not *same or better*, but LA is no worse than PR, as everywhere
  in the paper. LA stood in some trials, and at least as often as PR. Over the seeds in which both
  stood, LA's error is at most PR's.
* **differs**: neither holds.

A limit of delay is judged by its median over the seeds. Tables without PR have another ordering. In
Table V the local controller takes less time than the QP. In Table VI an error is above the error at
cardinality 0 where it is in the paper, and not above it elsewhere."""


class Verdict(Enum):
    """The relation of our number to the paper's; UNKNOWN if one of them is missing."""

    SAME_OR_BETTER = "same or better"
    SAME_ORDERING = "same ordering"
    DIFFERS = "differs"
    UNKNOWN = "–"


def within(ours: float | None, paper: float) -> bool:
    """Return whether an error or a time is at most the paper's, tolerance included."""
    return ours is not None and ours <= (1 + RELATIVE_TOLERANCE) * paper + ROUNDING


def no_worse(la: Outcome, pr: Outcome, metric: str) -> bool:
    """Return whether LA stood at least as often as PR, with an error of at most PR's."""
    if la.stood == 0 or la.rate < pr.rate:
        return False
    both = la.beside(pr, metric)
    return both is None or both[0] <= both[1] + EQUAL


def verdict(better: bool, ordered: bool) -> Verdict:
    """The verdict from two facts: whether the number is the same or better, and whether its
    ordering is the paper's.
    """
    if better:
        return Verdict.SAME_OR_BETTER
    return Verdict.SAME_ORDERING if ordered else Verdict.DIFFERS


def error_verdict(
    ours: Outcome, paper: float, *, metric: str, la: Outcome, pr: Outcome, paper_rate: float = 1.0
) -> Verdict:
    """The verdict on an error that the paper prints; `paper_rate` of its trials stood."""
    if not (ours.played and la.played and pr.played):
        return Verdict.UNKNOWN
    stood = ours.rate >= paper_rate and within(ours.error(metric), paper)
    return verdict(math.isinf(paper) or stood, no_worse(la, pr, metric))


def rate_verdict(ours: Outcome, paper_rate: float, *, la: Outcome, pr: Outcome) -> Verdict:
    """The verdict on a success rate that the paper prints."""
    if not (ours.played and la.played and pr.played):
        return Verdict.UNKNOWN
    return verdict(ours.rate >= paper_rate, la.stood > 0 and la.rate >= pr.rate)
