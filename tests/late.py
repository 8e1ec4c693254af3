"""`pytest --late SECONDS`: every process of a test and every service begins so much later.

Tests and `deploy.up` start others by `sys.executable`, in whose place a script is put that sleeps
before it becomes Python: process ids are what they were, and so are the command lines of services.
"""

from __future__ import annotations

import shlex
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

_SCRIPT = Path(__file__).with_name("late_start.py")


def stand_in(folder: Path, *, seconds: float) -> Path:
    """An executable in `folder` to run in place of Python."""
    file = folder / "late-python"
    words = (sys.executable, "-IS", _SCRIPT, sys.executable, file, seconds)
    file.write_text(f'#!/bin/sh\nexec {shlex.join(map(str, words))} "$@"\n')
    file.chmod(0o755)
    return file


def add_option(parser: pytest.Parser) -> None:
    """For `pytest_addoption`."""
    parser.addoption(
        "--late",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="start every process so much later: tests that wait for events pass all the same",
    )


def be_late(config: pytest.Config) -> None:
    """For `pytest_configure`."""
    seconds = config.getoption("late")
    if not seconds:
        return
    folder = Path(tempfile.mkdtemp(prefix="late-"))
    config.add_cleanup(lambda: shutil.rmtree(folder))
    before, sys.executable = sys.executable, str(stand_in(folder, seconds=seconds))
    config.add_cleanup(lambda: setattr(sys, "executable", before))
