"""Installed from a wheel, outside the checkout: the commands, the live stack, own packages."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.processes import ROOT
from tests.wheel import build, environment, install

pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("installed")
    made = environment(folder / "venv")
    install(made, build(folder))
    return made


@pytest.fixture
def wbc(programs: Path, tmp_path: Path):
    def run(*arguments: str) -> str:
        done = subprocess.run(
            [str(programs / "wbc"), *arguments],
            cwd=tmp_path,
            env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
            timeout=300.0,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def test_the_stack_runs_without_the_checkout(wbc, programs):
    found = subprocess.run(
        [str(programs / "python"), "-I", "-c", "import shared; print(shared.__file__)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert not Path(found.stdout.strip()).is_relative_to(ROOT)
    said = wbc("up", "--view", "off", "--duration", "1", "--push", "none", "--out", "run")
    assert "Stands after 1.00 s of balance with LA" in said


def test_a_package_made_by_new_is_installed_and_used_by_its_name(wbc, programs, tmp_path):
    wbc("new", "task", "swaying")
    wbc("new", "robot", "boxes")
    for name in ("swaying", "boxes"):
        install(programs, tmp_path / name)
    assert "balance, walk, go, swaying" in " ".join(wbc("trial", "--help").split())
    said = wbc("trial", "--task", "swaying", "--robot", "boxes", "--duration", "0.3")
    assert "Stands after 0.30 s of swaying" in said
