"""How a stack ends, with tiny processes for its services."""

from __future__ import annotations

import asyncio
import dataclasses
import os
import signal
import socket
import sys
from pathlib import Path

import pytest

from deploy.background.state import ENDED, StackFolder
from deploy.plan import Plan, PlannedService
from deploy.services import ROBOT, load_services
from deploy.stack import Run, StackRun
from shared.config.settings import RunConfig
from shared.errors import ConfigError, LinkError
from tests.processes import PATIENCE_SECONDS

# Services as modules, since those of a plan are started as such.
MODULES = {
    "serves": "print('READY', flush=True); import time; time.sleep(3600)",
    "is_killed": "print('READY', flush=True); import os; os.kill(os.getpid(), 9)",
    "fails": "print('READY', flush=True); print('error: no answer', flush=True); exit(2)",
    "signals": "print('READY', flush=True); import os, time; os.kill(os.getppid(), {0}); "
    "time.sleep({1}); exit(3)",
}


@pytest.fixture
def stack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A stack of a robot that runs one of the modules."""
    # Not isolated, so that it finds them.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("deploy.stack.python", lambda *arguments: [sys.executable, *arguments])
    (tmp_path / "run").mkdir()

    def make(module: str, *arguments: object) -> StackRun:
        (tmp_path / f"{module}.py").write_text(MODULES[module].format(*arguments))
        service = dataclasses.replace(load_services()[ROBOT], takes=())
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            hub = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        plan = Plan((PlannedService(service, (module,)),), None, ())
        return StackRun(Run(RunConfig(), plan, tmp_path / "run", hub, None))

    return make


def played(stack: StackRun) -> int:
    return asyncio.run(asyncio.wait_for(stack.run(), PATIENCE_SECONDS))


@pytest.mark.parametrize(
    ("module", "message"),
    [
        ("is_killed", r"robot ended \(signal 9\): all services were stopped"),
        ("fails", "its last line: no answer"),
    ],
)
def test_a_robot_that_fails_is_an_error_with_its_reason(tmp_path, stack, module, message):
    with pytest.raises(LinkError, match=message) as error:
        played(stack(module))
    state = StackFolder(tmp_path / "run").read()
    assert (state.state, state.exit_code, state.outcome) == (ENDED, 2, str(error.value))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_also_that_of_a_terminal_that_was_closed(tmp_path, stack, number):
    # Whoever runs the tests may be under nohup, or a background job, which ignores interrupts.
    before = signal.signal(number, signal.SIG_DFL)
    try:
        assert played(stack("signals", int(number), 3600)) == 130
    finally:
        signal.signal(number, before)
    folder = StackFolder(tmp_path / "run")
    assert not folder.alive
    state = folder.read()
    assert (state.state, state.exit_code, state.outcome) == (ENDED, 130, "stopped")
    with pytest.raises(ProcessLookupError):
        os.killpg(state.services[0].pid, 0)


def test_under_nohup_the_end_of_the_terminal_is_none(stack, monkeypatch):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert played(stack("signals", int(signal.SIGHUP), 0)) == 3
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_folder_that_cannot_be_written_is_the_users_mistake(tmp_path, stack):
    (tmp_path / "run/stack").write_text("in the way")
    with pytest.raises(ConfigError, match=r"out: cannot write .*stack"):
        played(stack("serves"))
