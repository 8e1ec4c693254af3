"""What every test may use: one loaded robot, its model and stacks, and random states near standing.

With several workers of pytest-xdist, one of them plays the tests in tests/live, before all others.
Meanwhile the other workers have a lower priority. They keep it, because only root may raise it
again: so it is not the lowest one, with which they would hardly go on beside other programs.

Linear algebra on one thread and with one kernel, as in every process of ours: results are the same
to the last bit on all machines that docs/reproduction.md names, and tests do not fight over cores.
"""

from __future__ import annotations

# isort: off
import shared.process.native_libraries  # noqa: F401

# isort: on
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from xdist import is_xdist_worker
from xdist.scheduler import LoadFileScheduling

from remote_wbc import __version__, commands
from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.motion.standing import Standing
from shared.process.cli import run, run_command
from shared.robots import Robot, load_robot
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack, make_stacks
from tests.late import add_option, be_late
from tests.processes import ROOT, Typed
from tests.states import State, random_states

# The niceness of tests beside a live stack: a quarter of a core that other programs want too.
_BESIDE_LIVE = 5

# The same examples in every run, however slow the machine is at that moment.
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user of the machine can reach; pytest's own are this user's alone."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder


def pytest_addoption(parser: pytest.Parser) -> None:
    add_option(parser)


def pytest_configure(config: pytest.Config) -> None:
    be_late(config)
    # The terminal of the caller is not that of the tests.
    os.environ["TERM"] = "xterm"
    for name in ("NO_COLOR", "COLUMNS", "LINES"):
        os.environ.pop(name, None)


def is_live(nodeid: str) -> bool:
    """Return whether a test starts stacks: only one such test runs at a time."""
    return nodeid.startswith("tests/live/")


class OneLiveWorker(LoadFileScheduling):  # type: ignore[misc]
    """The tests of a file stay in one worker, and those of all live files too."""

    def _split_scope(self, nodeid: str) -> str:
        return "live" if is_live(nodeid) else super()._split_scope(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> OneLiveWorker | None:
    return OneLiveWorker(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not is_live(item.nodeid))


def pytest_runtest_setup(item: pytest.Item) -> None:
    beside_live = is_xdist_worker(item.session) and is_live(item.session.items[0].nodeid)
    if beside_live and not is_live(item.nodeid):
        os.setpriority(os.PRIO_PROCESS, 0, _BESIDE_LIVE)


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


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Typed:
    """`typed("netem", "list")`: what `./wbc netem list` does, in this process."""
    monkeypatch.chdir(ROOT)

    def play(*words: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.setattr(sys, "argv", ["wbc", *words])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            run(lambda: run_command(None, commands(), version=__version__))
        assert isinstance(ended.value.code, int)
        return subprocess.CompletedProcess(words, ended.value.code, *capsys.readouterr())

    return play
