"""A wheel of this project, and a fresh environment with it, both made without a network."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path
from typing import Any

from shared.process.entry import python
from shared.toml_file import read_toml
from tests.processes import ROOT

PYPROJECT: dict[str, Any] = read_toml(ROOT / "pyproject.toml", what="the project")
PROJECT: dict[str, Any] = PYPROJECT["project"]
PACKAGES = sorted(
    name.removesuffix("*")
    for name in PYPROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
)
# What setuptools imports is what the lock file names; it fetches nothing.
BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"
# Of this environment: the checkout, and what a fresh one has by itself.
_LEFT_OUT = ("remote-wbc.pth", "pip", "__pycache__")


def build(folder: Path) -> Path:
    """Build the wheel from a copy in `folder`: setuptools leaves folders beside the sources."""
    copy = folder / "copy"
    for name in PACKAGES:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "remote_wbc.py", PROJECT["readme"], *PROJECT["license-files"]):
        shutil.copy(ROOT / name, copy)
    built = subprocess.run(
        python("-c", BUILD, str(folder)), cwd=copy, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / built.stdout.split()[-1]


def environment(folder: Path) -> Path:
    """Make an environment that has the dependencies, as links, and nothing of the checkout.

    Return its folder of programs.
    """
    venv.create(folder, with_pip=True, symlinks=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = folder / "lib" / version / "site-packages"
    # The setuptools that Python itself brings is older than the one of the lock.
    for each in packages.iterdir():
        if "pip" not in each.name:
            shutil.rmtree(each) if each.is_dir() else each.unlink()
    for each in Path(sysconfig.get_path("purelib")).iterdir():
        if each.name not in _LEFT_OUT and not each.name.startswith("pip-"):
            (packages / each.name).symlink_to(each)
    return folder / "bin"


def install(programs: Path, what: Path) -> None:
    """Install a wheel or a folder into an environment, without its dependencies."""
    options = ("--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check")
    done = subprocess.run(
        [str(programs / "python"), "-I", "-m", "pip", "install", "-q", *options, str(what)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
