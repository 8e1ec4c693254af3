"""Our number beside the paper's: same or better, same ordering, or differs.

RULE is that rule for a reader; `docs/results.md` prints it.
"""

from __future__ import annotations

import math
from enum import Enum

from experiments.reproduction.outcome import Outcome

# Of the paper's number, and half of the last digit that it prints.
RELATIVE_TOLERANCE = 0.05
ROUNDING = 0.005
# The same command twice: projectors go over the link as float32.
EQUAL = 1e-6

RULE = f"""\
Every number of the paper has a verdict. A trial stands or falls; an error is the mean over the
trials that stood, ∞ where none did.

* **same or better**: at least as many stood as in the paper (its success rate in Table IV, all of
  them where it prints an error over a constant delay), and the error is at most
  {1 + RELATIVE_TOLERANCE:g} × the paper's, plus half of its last digit, {ROUNDING:g}. Where the
  paper has ∞, any outcome is.
* **same ordering**: not so, but LA is no worse than PR, as everywhere in the paper: LA stood at
  least as often, and over the seeds in which both stood its error is not the larger. Where PR never
  stood, LA did.
* **differs**: neither.

A limit of delay is judged by its median over the seeds. Tables without PR have an order of their
own: in Table V the local controller takes less time than the QP; in Table VI an error is above, or
is not above, that at cardinality 0, as in the paper."""


class Verdict(Enum):
    """How our number stands to the paper's; UNKNOWN if either is missing."""

    SAME_OR_BETTER = "same or better"
    SAME_ORDERING = "same ordering"
    DIFFERS = "differs"
    UNKNOWN = "–"


def within(ours: float | None, paper: float) -> bool:
    """Whether an error or a time is at most the paper's, tolerance included."""
    return ours is not None and ours <= (1 + RELATIVE_TOLERANCE) * paper + ROUNDING


def no_worse(la: Outcome, pr: Outcome, metric: str) -> bool:
    """Whether LA stood at least as often as PR with an error that is not the larger."""
    if la.stood == 0 or la.rate < pr.rate:
        return False
    both = la.beside(pr, metric)
    return both is None or both[0] <= both[1] + EQUAL


def verdict(better: bool, ordered: bool) -> Verdict:
    """The better of two verdicts that is true."""
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
