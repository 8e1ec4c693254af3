"""Cells of text in columns, for a terminal or a text file."""

from __future__ import annotations

from collections.abc import Sequence


def aligned(lines: Sequence[Sequence[str]], *, left: int | None = None) -> list[str]:
    """Return the lines with their cells in columns, two spaces apart.

    All lines have the same number of cells. The first `left` columns are aligned on the left, the
    others, which are numbers, on the right. None: all are aligned on the left.
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
