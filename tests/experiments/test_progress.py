from __future__ import annotations

import io
import os

import pytest

from experiments.studies import progress as module
from experiments.studies.progress import Progress
from tests.members import replace_members


class Terminal(io.StringIO):
    def isatty(self):
        return True

    def fileno(self):
        return 2


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand."""
    seconds = [0.0]
    replace_members(monkeypatch, module, "time", perf_counter=lambda: seconds[0])
    return seconds


@pytest.fixture
def terminal(monkeypatch):
    """Standard error on a terminal of so many columns."""

    def of(columns):
        monkeypatch.setattr("sys.stderr", Terminal())
        size = os.terminal_size((columns, 24))
        replace_members(monkeypatch, module, "os", get_terminal_size=lambda _: size)

    return of


def test_a_bar_says_how_far_it_is_and_how_long_it_takes(terminal, clock):
    terminal(80)
    progress = Progress(done=10, falls=1, left=30)
    assert progress.line() == "▕" + "█" * 10 + " " * 30 + "▏ 10/40, 1 falls"
    clock[0] = 5.0
    progress.finished(fell=True, left=29)
    assert progress.line().endswith("▏ 11/40, 2 falls, 12.0/min, 2:25 left")
    # A bisection has come to its end earlier than it might have.
    clock[0] = 10.0
    progress.finished(fell=False, left=4)
    assert progress.line().endswith(" 12/16, 2 falls, 12.0/min, 0:20 left")
    assert progress.line().count("█") / progress.line().index("▏") == pytest.approx(0.75, abs=0.05)
    assert progress.about() == {"played": 2, "wall_seconds": 10.0, "trials_per_minute": 12.0}


@pytest.mark.parametrize("columns", [0, 20, 48, 49, 50, 60, 200])
def test_a_line_never_wraps_for_the_bar(terminal, clock, columns):
    terminal(columns)
    progress = Progress(done=100, falls=3, left=900)
    clock[0] = 1.0
    progress.finished(fell=False, left=899)
    text = "101/1000, 3 falls, 60.0/min, 14:59 left"
    assert progress.line().endswith(text)
    assert len(progress.line()) < max(columns or 80, len(text) + 1)


def test_without_a_terminal_there_is_a_line_without_a_bar(monkeypatch, clock):
    monkeypatch.setattr("sys.stderr", io.StringIO())
    progress = Progress(done=0, falls=0, left=30)
    clock[0] = 10.0
    for left in reversed(range(20, 30)):
        progress.finished(fell=False, left=left)
    assert progress.line() == "trials 10/30, 0 falls, 60.0/min, 0:20 left"
