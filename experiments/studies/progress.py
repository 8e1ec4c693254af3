"""Progress of a sweep: a bar in place on a terminal, else a line every ten seconds."""

from __future__ import annotations

import os
import sys
import time

from shared.output.screen import rewrites_lines

_EVERY_SECONDS = 10.0
_BAR = (10, 40)
# Width of a terminal that does not report it [characters].
_COLUMNS = 80


class Progress:
    """Trials `done` and `left`. In a bisection `left` is an upper bound, which shrinks."""

    def __init__(self, *, done: int, falls: int, left: int) -> None:
        self._done, self._falls, self._left = done, falls, left
        self._played = 0
        self._started = self._printed = time.perf_counter()
        self._terminal = rewrites_lines(sys.stderr)
        self._open = False
        if self._terminal and left > 0:
            self._print()

    def finished(self, *, fell: bool, left: int) -> None:
        """Count one more trial."""
        self._played += 1
        self._done += 1
        self._falls += fell
        self._left = left
        if self._terminal or left == 0 or time.perf_counter() - self._printed >= _EVERY_SECONDS:
            self._print()

    def about(self) -> dict[str, float]:
        """The number of trials played, the time [s], and the rate [1/min]."""
        seconds = time.perf_counter() - self._started
        return {
            "played": self._played,
            "wall_seconds": round(seconds, 1),
            "trials_per_minute": round(60 * self._played / seconds, 2),
        }

    def close(self) -> None:
        """End the line of the bar, so that the next output begins on a new line."""
        if self._open:
            print(file=sys.stderr, flush=True)
            self._open = False

    def _print(self) -> None:
        self._printed = time.perf_counter()
        total = self._done + self._left
        text = f"{self._done}/{total}, {self._falls} falls"
        if self._played:
            rate = self._played / (self._printed - self._started)
            left = round(self._left / rate)
            text += f", {60 * rate:.1f}/min, {left // 60}:{left % 60:02} left"
        if not self._terminal:
            print(f"trials {text}", file=sys.stderr, flush=True)
            return
        min_width, max_width = _BAR
        columns = os.get_terminal_size(sys.stderr.fileno()).columns or _COLUMNS
        width = min(columns - len(text) - 4, max_width)
        bar = ""
        if width >= min_width:
            full = width * self._done // total
            bar = f"▕{'█' * full}{' ' * (width - full)}▏ "
        print(f"\r\x1b[K{bar}{text}", end="", file=sys.stderr, flush=True)
        self._open = True
