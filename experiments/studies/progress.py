"""Progress of a sweep in a line: its trials, its falls, its rate, and a bar on a terminal."""

from __future__ import annotations

import os
import sys
import time

from shared.output.screen import rewrites_lines

_BAR = (10, 40)
# Width of a terminal that does not report it [characters].
_COLUMNS = 80


class Progress:
    """Trials `done` and `left`. In a bisection `left` is an upper bound, which shrinks."""

    def __init__(self, *, done: int, falls: int, left: int) -> None:
        self._done, self._falls, self._left = done, falls, left
        self._played = 0
        self._started = time.perf_counter()

    def finished(self, *, fell: bool, left: int) -> None:
        """Count one more trial."""
        self._played += 1
        self._done += 1
        self._falls += fell
        self._left = left

    def about(self) -> dict[str, float]:
        """The number of trials played, the time [s], and the rate [1/min]."""
        seconds = time.perf_counter() - self._started
        return {
            "played": self._played,
            "wall_seconds": round(seconds, 1),
            "trials_per_minute": round(60 * self._played / seconds, 2),
        }

    def line(self) -> str:
        """Return the line for standard error, no longer than a terminal there is wide."""
        total = self._done + self._left
        text = f"{self._done}/{total}, {self._falls} falls"
        if self._played:
            rate = self._played / (time.perf_counter() - self._started)
            left = round(self._left / rate)
            text += f", {60 * rate:.1f}/min, {left // 60}:{left % 60:02} left"
        if not rewrites_lines(sys.stderr):
            return f"trials {text}"
        min_width, max_width = _BAR
        columns = os.get_terminal_size(sys.stderr.fileno()).columns or _COLUMNS
        width = min(columns - len(text) - 4, max_width)
        if width < min_width:
            return text
        full = width * self._done // total
        return f"▕{'█' * full}{' ' * (width - full)}▏ {text}"
