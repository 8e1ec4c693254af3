"""A service as a container runs it, without the container."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.processes import Process, descendants_naming, until

pytestmark = pytest.mark.live

Start = Callable[..., Process]


@pytest.fixture
def ready_file(tmp_path: Path) -> Path:
    return tmp_path / "ready"


@pytest.fixture
def contained(start: Start, ready_file: Path) -> Start:
    """Starts a service as a container does, except for where it says that it is ready."""
    flags = ("--ready-file", str(ready_file))
    return lambda *arguments: start("deploy.container", *flags, *arguments)


def test_it_is_healthy_when_it_is_ready_and_ends_at_a_signal(
    contained: Start, ready_file: Path, endpoints: list[str]
) -> None:
    serving = contained("router", "--listen", endpoints[0])
    assert serving.wait_for("READY") == f"READY {endpoints[0]}, admits everybody"
    until(ready_file.exists, lambda: f"no {ready_file}")
    serving.signal(signal.SIGTERM)
    assert serving.wait() == 0, serving.output
    assert descendants_naming(endpoints[0]) == []


def test_one_that_cannot_start_is_not_healthy_and_an_error(
    contained: Start, ready_file: Path
) -> None:
    # Of a container that was stopped and is started again.
    ready_file.touch()
    failing = contained("router", "--listen", "tcp/192.0.2.1:7447")
    assert failing.wait() == 2
    assert "error: router did not start (exit 2)" in failing.lines[-1]
    assert not ready_file.exists()


def test_one_that_is_killed_has_the_exit_code_that_docker_gives_it(
    contained: Start, endpoints: list[str]
) -> None:
    serving = contained("router", "--listen", endpoints[0])
    serving.wait_for("READY")
    (service,) = set(descendants_naming(endpoints[0])) - {serving.popen.pid}
    os.kill(service, signal.SIGKILL)
    assert serving.wait() == 137, serving.output
