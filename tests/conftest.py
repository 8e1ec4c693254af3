"""What every test may use: one loaded robot, its model and stacks, and random states near standing.

Linear algebra on one thread and with one kernel, as in every process of ours: results are the same
to the last bit on all machines that docs/reproduction.md names, and tests do not fight over cores.
"""

from __future__ import annotations

# isort: off
import shared.process.native_libraries  # noqa: F401

# isort: on
import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.motion.standing import Standing
from shared.robots import Robot, load_robot
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack, make_stacks
from tests.late import add_option, be_late
from tests.states import State, random_states

# The same examples in every run, however slow the machine is at that moment.
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


def pytest_addoption(parser: pytest.Parser) -> None:
    add_option(parser)


def pytest_configure(config: pytest.Config) -> None:
    be_late(config)
    # The terminal of the caller is not that of the tests.
    os.environ["TERM"] = "xterm"
    for name in ("NO_COLOR", "COLUMNS", "LINES"):
        os.environ.pop(name, None)


@pytest.fixture(scope="session")
def config() -> RunConfig:
    return RunConfig()


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("romeo")


@pytest.fixture(scope="session")
def model(robot: Robot) -> WholeBodyModel:
    return WholeBodyModel(robot)


@pytest.fixture(scope="session")
def motion(robot: Robot) -> Standing:
    return Standing(robot)


@pytest.fixture(scope="session")
def reference(motion: Standing) -> Reference:
    return motion.reference(0)


@pytest.fixture(scope="session")
def stacks(robot: Robot, config: RunConfig) -> dict[ContactMode, Stack]:
    return make_stacks(robot, config.wbc)


@pytest.fixture(scope="session")
def states(robot: Robot) -> list[State]:
    """Fifty states from near standing to limbs all over the place, the same in every test."""
    return random_states(robot, count=50, rng=np.random.default_rng(20))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.fixture(scope="session")
def configured() -> Callable[..., RunConfig]:
    """A configuration with dotted keys changed: `configured(**{"link.loss": 0.3})`."""

    def build(**overrides: Any) -> RunConfig:
        return load_config(None, overrides)

    return build
