"""Where a window can open, and the line of status."""

from __future__ import annotations

import io
import sys
import threading

import pytest

from shared.output.screen import StatusLine, has_screen, rewrites_lines


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_on_linux_a_display_server_is_a_screen(monkeypatch, name):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not has_screen()
    monkeypatch.setenv(name, ":0")
    assert has_screen()


def test_elsewhere_there_is_a_screen_without_one(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert has_screen()


@pytest.mark.parametrize(
    ("terminal", "kind", "expected"),
    [(True, "xterm", True), (True, "dumb", False), (False, "xterm", False)],
)
def test_a_line_is_rewritten_on_a_terminal_that_can(monkeypatch, terminal, kind, expected):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.setenv("TERM", kind)
    assert rewrites_lines(sys.stdout) == expected


class _Stream(io.StringIO):
    """A stream that tells when something was written, and may be a terminal or closed."""

    def __init__(self, *, terminal=True, broken=False):
        super().__init__()
        self.terminal, self.broken = terminal, broken
        self.tried = threading.Event()

    def isatty(self):
        return self.terminal

    def write(self, text):
        self.tried.set()
        if self.broken:
            raise BrokenPipeError
        return super().write(text)


def test_the_line_of_status_is_cleared_at_the_end(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    stream = _Stream()
    with StatusLine(lambda: "half", stream=stream):
        assert stream.tried.wait(60.0)
    assert "half" in stream.getvalue()
    assert stream.getvalue().endswith("\r\033[2K")


def test_work_that_ends_at_once_has_no_line_of_status(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    stream = _Stream()
    with StatusLine(lambda: "half", stream=stream, quiet=3600.0):
        pass
    assert stream.getvalue() == ""


@pytest.mark.parametrize(("terminal", "shown"), [(True, "\r\033[2Kall\n"), (False, "all\n")])
def test_a_line_that_stays_is_printed_at_the_end(monkeypatch, terminal, shown):
    monkeypatch.setenv("TERM", "xterm")
    stream = _Stream(terminal=terminal)
    with StatusLine(lambda: "all", stream=stream, quiet=3600.0, stays=True):
        pass
    assert stream.getvalue() == shown


@pytest.mark.parametrize("stays", [True, False])
def test_a_stream_that_cannot_be_written_ends_nothing(monkeypatch, stays):
    monkeypatch.setenv("TERM", "xterm")
    stream = _Stream(broken=True)
    status = StatusLine(lambda: "half", stream=stream, stays=stays)
    with status:
        assert stream.tried.wait(60.0)
        status._thread.join(60.0)
        assert not status._thread.is_alive()
