"""Real processes on loopback, each ended by its own pid."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import pytest

from benchmarks.link_paths import free_endpoints
from benchmarks.real_path.namespaces import Machine
from tests.processes import Process
from tests.telemetry_hub import TelemetryHub


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Starts `python -m …`; everything started is ended with the test."""
    started: list[Process] = []

    def launch(
        *arguments: str, machine: Machine | None = None, env: dict[str, str] | None = None
    ) -> Process:
        started.append(Process(*arguments, machine=machine, env=env))
        return started[-1]

    yield launch
    for process in reversed(started):
        process.end()


@pytest.fixture
def endpoints() -> list[str]:
    """Two free loopback endpoints."""
    return free_endpoints(2)


@pytest.fixture
def hub() -> Iterator[Callable[[], TelemetryHub]]:
    """Makes hubs for the telemetry of a robot each."""
    with contextlib.ExitStack() as hubs:

        def make() -> TelemetryHub:
            return hubs.enter_context(contextlib.closing(TelemetryHub(*free_endpoints(1))))

        yield make
