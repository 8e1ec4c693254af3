"""A table of text, for Markdown and for a terminal, and the format of its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from experiments.reproduction.outcome import Outcome
from shared.output.text_table import aligned

FELL = "∞"
NONE = "–"


@dataclass(frozen=True)
class Table:
    """A title, column headings, lines with a text for each column, and a note below."""

    title: str
    columns: Sequence[str]
    lines: Sequence[Sequence[str]]
    note: str = ""


def in_markdown(table: Table, *, heading: bool = False) -> str:
    """The table with its title, in bold or as a heading of the third level."""
    rows = [table.columns, ["---"] * len(table.columns), *table.lines]
    title = f"### {table.title}" if heading else f"**{table.title}**"
    text = [title, "", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join([*text, *(["", table.note] if table.note else [])])


def in_columns(table: Table) -> str:
    """The table for a terminal."""
    note = [table.note] if table.note else []
    return "\n".join([table.title, *aligned([table.columns, *table.lines]), *note])


def number(value: float | None) -> str:
    """Format a number with two decimals as in the paper, with more where that gives 0.00."""
    if value is None:
        return NONE
    if abs(value) >= 0.005 or value == 0.0:
        return FELL if value == float("inf") else f"{value:.2f}"
    return f"{value:.4f}" if abs(value) >= 5e-5 else f"{value:.0e}"


def error_in_words(outcome: Outcome, metric: str, *, some: bool = True) -> str:
    """The mean error over the trials that stood; with `some`, also their number if any fell."""
    if not outcome.played:
        return NONE
    if not outcome.stood:
        return FELL
    partial = some and outcome.stood < outcome.played
    of = f" ({outcome.stood}/{outcome.played} stood)" if partial else ""
    return number(outcome.error(metric)) + of


def rate_in_words(outcome: Outcome) -> str:
    """A success rate, with the number of trials that stood and its Wilson interval."""
    if not outcome.played:
        return NONE
    return f"{100 * outcome.rate:.0f} %, {stood_in_words(outcome)}"


def stood_in_words(outcome: Outcome) -> str:
    """The number of trials that stood, with the Wilson interval of the rate."""
    if not outcome.played:
        return NONE
    low, high = outcome.interval
    return f"{outcome.stood}/{outcome.played} ({100 * low:.0f}–{100 * high:.0f} %)"
