"""A process that leaves its starter, in processes of their own: forks do not belong into a test."""

from __future__ import annotations

import pytest

from shared.process.entry import python
from tests.processes import played

BEGINS = """
import os, signal, sys
from deploy.background.detach import in_background, tell_ready
from shared.errors import LinkError

def play(ready_fd):
    print("begun", flush=True)
    {0}

try:
    raise SystemExit(in_background(play))
except LinkError as error:
    print(error)
"""
READY = "tell_ready(ready_fd, 2); print('unheard'); return 4"
STDIN_IS_EMPTY = "return 5 if sys.stdin.read() == '' and os.getsid(0) == os.getpid() else 6"


@pytest.mark.parametrize(
    ("play", "code", "message"),
    [
        (READY, 0, "begun\n"),
        ("return 3", 3, "begun\n"),
        (STDIN_IS_EMPTY, 5, "begun\n"),
        (
            "os.kill(os.getpid(), signal.SIGKILL)",
            0,
            "begun\nthe stack was killed (signal 9) before it was ready\n",
        ),
    ],
)
def test_whoever_starts_it_waits_until_it_is_ready_or_has_its_exit_code(play, code, message):
    done = played(*python("-c", BEGINS.format(play)), given="typed\n")
    assert done.stderr == ""
    assert (done.returncode, done.stdout) == (code, message)


def test_a_signal_until_then_ends_it_too():
    play = "os.kill(os.getppid(), signal.SIGINT); __import__('time').sleep(3600.0); return 0"
    done = played(*python("-c", BEGINS.format(play)))
    assert done.returncode == 130, done.stderr
