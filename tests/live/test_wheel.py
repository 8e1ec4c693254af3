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


def test_nothing_of_the_checkout_is_imported(programs):
    found = subprocess.run(
        [str(programs / "python"), "-I", "-c", "import shared; print(shared.__file__)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert not Path(found.stdout.strip()).is_relative_to(ROOT)


def test_packages_made_by_new_are_installed_and_used_by_their_names(wbc, programs, tmp_path):
    made = {"controller": "steady", "task": "swaying", "plant": "boxes"}
    for kind, name in made.items():
        wbc("new", kind, name)
        install(programs, tmp_path / name)
    assert "balance, walk, go, swaying" in " ".join(wbc("trial", "--help").split())
    wbc("plant", "check", "--robot", "boxes", "--plant", "boxes")
    own = ("--controller", "steady", "--task", "swaying", "--robot", "boxes", "--plant", "boxes")
    options = ("--view", "off", "--duration", "0.5", "--push", "none", "--out", "own")
    said = wbc("up", *own, *options)
    assert "Stands after 0.50 s of swaying with steady" in said
