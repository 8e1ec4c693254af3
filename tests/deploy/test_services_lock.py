"""`services.lock` is the part of `requirements.lock` that the services need, and all of it."""

from __future__ import annotations

import ast
import re
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# What the image has of the project: .dockerignore.
PACKAGES = ("shared", "robot_node", "edge_node", "netem", "viewer", "deploy")
# Imported by what no service runs: figures, films, the docs site, and the check of an installation.
ELSEWHERE = {"av", "matplotlib", "mkdocs", "pymdownx", "latex2mathml", "pip"}


def pins(lock: str) -> dict[str, set[str]]:
    """Hashes by `name==version`."""
    found: dict[str, set[str]] = {}
    current: set[str] = set()
    for line in (ROOT / lock).read_text().splitlines():
        if pin := re.match(r"([\w.-]+)(?:\[.*\])?==([^\s;\\]+)", line):
            current = found.setdefault(f"{pin[1]}=={pin[2]}", set())
        elif digest := re.match(r"\s+--hash=(sha256:[0-9a-f]{64})", line):
            current.add(digest[1])
    return found


@pytest.fixture(scope="module")
def services() -> dict[str, set[str]]:
    return pins("deploy/services.lock")


def test_every_pin_is_that_of_the_whole_lock(services: dict[str, set[str]]) -> None:
    whole = pins("requirements.lock")
    assert len(services) > 40
    assert {pin: whole.get(pin) for pin in services} == services


def test_it_has_no_line_but_names_versions_hashes_and_reasons() -> None:
    lines = (ROOT / "deploy/services.lock").read_text().splitlines()
    assert all(
        re.match(r"#|    #|[\w.-]+(\[\w+\])?==|    --hash=sha256:[0-9a-f]{64}", line)
        for line in lines
    )
    assert not any("://" in line for line in lines)


def test_what_the_services_import_is_in_it(services: dict[str, set[str]]) -> None:
    named = {_normal(pin.partition("==")[0]) for pin in services}
    # Its files are in a folder of cmeel's, which is no package.
    distributions = {**packages_distributions(), "pinocchio": ["pin"]}
    missing = {
        module
        for module in _imported() - ELSEWHERE - set(PACKAGES)
        if named.isdisjoint(map(_normal, distributions.get(module, [module])))
    }
    assert missing == set()


def test_what_is_imported_elsewhere_is_not_in_it(services: dict[str, set[str]]) -> None:
    named = {_normal(pin.partition("==")[0]) for pin in services}
    distributions = packages_distributions()
    # One may be an extra that is not installed here.
    assert named.isdisjoint(
        _normal(each) for name in ELSEWHERE for each in distributions.get(name, [name])
    )
    assert named.isdisjoint({"pytest", "mypy", "ruff", "distributed"})


def _imported() -> set[str]:
    """Top-level names of other people's modules, wherever in a file they are imported."""
    names: set[str] = set()
    for file in (file for each in PACKAGES for file in (ROOT / each).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.partition(".")[0])
    ours = {file.stem for file in ROOT.glob("*.py")}
    return names - set(sys.stdlib_module_names) - ours


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
