"""A service as a container runs it, without the container."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from deploy.container import READY_FILE
from tests.live.conftest import Process, descendants_naming

pytestmark = pytest.mark.live

Start = Callable[..., Process]


@pytest.fixture(autouse=True)
def ready_file() -> Iterator[None]:
    yield
    READY_FILE.unlink(missing_ok=True)


def test_it_is_healthy_when_it_is_ready_and_ends_at_a_signal(
    start: Start, endpoints: list[str]
) -> None:
    serving = start("deploy.container", "router", "--listen", endpoints[0])
    assert serving.wait_for("READY") == f"READY {endpoints[0]}, admits everybody"
    deadline = time.monotonic() + 30.0
    while not READY_FILE.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert READY_FILE.exists()
    serving.signal(signal.SIGTERM)
    assert serving.wait() == 0, serving.output
    assert descendants_naming(endpoints[0]) == []


def test_one_that_cannot_start_is_not_healthy_and_an_error(start: Start) -> None:
    # Of a container that was stopped and is started again.
    READY_FILE.touch()
    failing = start("deploy.container", "router", "--listen", "tcp/192.0.2.1:7447")
    assert failing.wait() == 2
    assert "error: router did not start (exit 2)" in failing.lines[-1]
    assert not READY_FILE.exists()


def test_one_that_is_killed_has_the_exit_code_that_docker_gives_it(
    start: Start, endpoints: list[str]
) -> None:
    serving = start("deploy.container", "router", "--listen", endpoints[0])
    serving.wait_for("READY")
    (service,) = set(descendants_naming(endpoints[0])) - {serving.popen.pid}
    os.kill(service, signal.SIGKILL)
    assert serving.wait() == 137, serving.output
