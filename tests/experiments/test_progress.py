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
def terminal(monkeypatch):
    """A terminal of so many columns, and a clock that is set by hand."""

    def of(columns):
        stream, clock = Terminal(), [0.0]
        monkeypatch.setattr("sys.stderr", stream)
        replace_members(monkeypatch, module, "time", perf_counter=lambda: clock[0])
        size = os.terminal_size((columns, 24))
        replace_members(monkeypatch, module, "os", get_terminal_size=lambda _: size)
        return stream, clock

    return of


def shown(stream):
    """What stands in the line now."""
    return stream.getvalue().rpartition("\x1b[K")[2]


def test_a_bar_says_how_far_it_is_and_how_long_it_takes(terminal):
    stream, clock = terminal(80)
    progress = Progress(done=10, falls=1, left=30)
    assert shown(stream) == "▕" + "█" * 10 + " " * 30 + "▏ 10/40, 1 falls"
    clock[0] = 5.0
    progress.finished(fell=True, left=29)
    assert shown(stream).endswith("▏ 11/40, 2 falls, 12.0/min, 2:25 left")
    # A bisection has come to its end earlier than it might have.
    clock[0] = 10.0
    progress.finished(fell=False, left=4)
    assert shown(stream).endswith(" 12/16, 2 falls, 12.0/min, 0:20 left")
    assert shown(stream).count("█") / shown(stream).index("▏") == pytest.approx(12 / 16, abs=0.05)
    assert "\n" not in stream.getvalue()
    progress.close()
    progress.close()
    assert stream.getvalue().count("\n") == 1
    assert progress.about() == {"played": 2, "wall_seconds": 10.0, "trials_per_minute": 12.0}


@pytest.mark.parametrize("columns", [0, 20, 48, 49, 50, 60, 200])
def test_a_line_never_wraps_for_the_bar(terminal, columns):
    stream, clock = terminal(columns)
    progress = Progress(done=100, falls=3, left=900)
    clock[0] = 1.0
    progress.finished(fell=False, left=899)
    text = "101/1000, 3 falls, 60.0/min, 14:59 left"
    assert shown(stream).endswith(text)
    assert len(shown(stream)) < max(columns or 80, len(text) + 1)


def test_without_a_terminal_there_is_a_line_every_ten_seconds(monkeypatch, capsys):
    clock = [0.0]
    replace_members(monkeypatch, module, "time", perf_counter=lambda: clock[0])
    progress = Progress(done=0, falls=0, left=30)
    for left in reversed(range(30)):
        clock[0] += 1.0
        progress.finished(fell=False, left=left)
    progress.close()
    assert capsys.readouterr().err.splitlines() == [
        "trials 10/30, 0 falls, 60.0/min, 0:20 left",
        "trials 20/30, 0 falls, 60.0/min, 0:10 left",
        "trials 30/30, 0 falls, 60.0/min, 0:00 left",
    ]
