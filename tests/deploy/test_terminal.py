from __future__ import annotations

import contextlib
import itertools
import os
import sys
from pathlib import Path

import pytest

from deploy.background.state import LineFile
from deploy.console import terminal as console
from deploy.console.terminal import Terminal, service_line
from tests.members import replace_members


@pytest.fixture
def copy(tmp_path: Path):
    with LineFile(tmp_path / "log") as file:
        yield file


@pytest.fixture
def kept(tmp_path: Path):
    return lambda: (tmp_path / "log").read_text()


def test_other_users_cannot_read_the_lines(copy, tmp_path):
    copy.add("the secret address of a page")
    assert (tmp_path / "log").stat().st_mode & 0o077 == 0


def test_elsewhere_than_on_a_terminal_there_are_no_escape_codes(copy, kept, capsys):
    terminal = Terminal(copy)
    terminal.say("edge", "READY")
    terminal.show("t 1 s")
    terminal.show("t 2 s")
    terminal.clear()
    terminal.tell("Stands\n  files")
    assert capsys.readouterr().out == "  edge | READY\nstatus | t 1 s\nStands\n  files\n"
    assert kept() == "  edge | READY\nStands\n  files\n"


def test_on_a_terminal_the_status_line_stays_last_and_fits(copy, kept, monkeypatch, capsys):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "30")
    terminal = Terminal(copy)
    terminal.show("x" * 100)
    assert capsys.readouterr().out.endswith("\r\x1b[2K" + "x" * 29)
    terminal.say("edge", "hello")
    out = capsys.readouterr().out
    assert out.startswith("\r\x1b[2K\x1b[34m")
    assert out.endswith("hello\n" + "x" * 29)
    # For whoever reads it later.
    assert kept() == "  edge | hello\n"


def test_whoever_was_left_hears_no_more_and_the_copy_goes_on(copy, kept, capsys):
    terminal = Terminal(copy)
    terminal.leave()
    terminal.say("edge", "READY")
    terminal.show("t 1 s")
    terminal.tell("Stands")
    terminal.note("error: none")
    assert capsys.readouterr().out == ""
    assert kept() == "  edge | READY\nStands\nerror: none\n"


@contextlib.contextmanager
def read_by_nobody():
    """Standard output is a pipe whose reader has left."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as file:
        with contextlib.redirect_stdout(file):
            yield
        # What could not be written would be tried again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), writing)


def test_whoever_has_left_is_no_reason_to_end_and_the_copy_goes_on(copy, kept):
    with read_by_nobody():
        terminal = Terminal(copy)
        for line in ("READY", "stopped"):
            terminal.say("edge", line)
        terminal.show("t 1 s")
        terminal.clear()
    assert kept() == "  edge | READY\n  edge | stopped\n"


def test_lines_that_are_kept_nowhere_end_with_whoever_reads_them():
    with read_by_nobody(), pytest.raises(BrokenPipeError):
        Terminal().say("edge", "READY")


def test_a_full_disk_is_no_reason_to_end(capsys):
    with LineFile(Path("/dev/full")) as full:
        Terminal(full).say("edge", "READY")
    assert capsys.readouterr().out == "  edge | READY\n"


def test_a_line_of_a_copy_is_known_by_who_said_it():
    assert service_line(" robot | 1.00 s: a | b") == ("robot", "1.00 s: a | b")
    assert service_line("Stands after 5.00 s") is None
    assert service_line("  CoM error 1.2 cm") is None


def test_elsewhere_a_status_is_said_again_only_when_it_is_another(monkeypatch, capsys):
    replace_members(monkeypatch, console, "time", monotonic=itertools.count(0, 2).__next__)
    terminal = Terminal()
    for status in ("waiting", "waiting", "t 1 s"):
        terminal.show(status)
    assert capsys.readouterr().out == "status | waiting\nstatus | t 1 s\n"
