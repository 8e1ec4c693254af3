"""The package: what a wheel of it has, and what pyproject.toml says of it beside other files."""

from __future__ import annotations

import re
import zipfile

import pytest
import yaml

from remote_wbc import __version__
from tests.processes import ROOT
from tests.wheel import PACKAGES, PROJECT, build


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    return zipfile.ZipFile(build(tmp_path_factory.mktemp("wheel")))


def test_a_wheel_has_every_module_and_no_test(wheel: zipfile.ZipFile) -> None:
    ours = {
        path.relative_to(ROOT).as_posix()
        for path in (
            *ROOT.glob("*.py"),
            *(each for p in PACKAGES for each in (ROOT / p).rglob("*.py")),
        )
    }
    assert {name for name in wheel.namelist() if name.endswith(".py")} == ours


@pytest.mark.parametrize("package", PACKAGES)
def test_a_wheel_says_that_a_package_is_typed(wheel: zipfile.ZipFile, package: str) -> None:
    assert f"{package}/py.typed" in wheel.namelist()


def test_a_wheel_has_the_data_that_the_code_reads(wheel: zipfile.ZipFile) -> None:
    data = {
        path.relative_to(ROOT).as_posix()
        for folder in PACKAGES
        for suffix in ("toml", "npz", "txt", "urdf", "html", "css", "js")
        for path in (ROOT / folder).rglob(f"*.{suffix}")
    }
    assert len(data) > 100
    # Settings of the stack in Docker, which is started in the repository.
    assert data - set(wheel.namelist()) == {"deploy/compose.toml"}


def test_a_wheel_has_the_licence_and_names_it(wheel: zipfile.ZipFile) -> None:
    folder = f"{PROJECT['name'].replace('-', '_')}-{__version__}.dist-info"
    text = (ROOT / "LICENSE").read_text()
    assert wheel.read(f"{folder}/licenses/LICENSE").decode() == text
    assert "Version 2.0, January 2004" in text
    assert re.search(
        "^License-Expression: Apache-2.0$", wheel.read(f"{folder}/METADATA").decode(), re.M
    )


def test_the_citation_and_the_changelog_are_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    # What version 1.2 of the format requires of a file, and of a work that it refers to.
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert all({"type", "title", "authors"} <= work.keys() for work in citation["references"])
    assert (citation["version"], citation["license"], citation["authors"]) == (
        __version__,
        PROJECT["license"],
        PROJECT["authors"],
    )
    assert __version__ in (ROOT / "CHANGELOG.md").read_text()


def test_no_index_takes_it_by_mistake() -> None:
    assert "Private :: Do Not Upload" in PROJECT["classifiers"]
