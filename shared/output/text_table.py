"""Cells of text in columns, for a terminal or a text file."""

from __future__ import annotations

from collections.abc import Sequence


def aligned(lines: Sequence[Sequence[str]], *, left: int | None = None) -> list[str]:
    """Lines of as many cells each, two spaces between columns.

    The first `left` columns begin at the same place and the others, numbers, end there; None: all
    begin there.
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    n_left = len(widths) if left is None else left
    padded = [
        [
            cell.ljust(width) if k < n_left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    ]
    return ["  ".join(line).rstrip() for line in padded]
