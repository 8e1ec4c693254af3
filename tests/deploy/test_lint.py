"""The checks before the tests stand in one place, deploy/lint, for deploy/test and pre-commit."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml

from tests.processes import ROOT, played

LINT = (ROOT / "deploy/lint").read_text()
CHECKS = re.findall(r"^        (\w+)\)$", LINT, re.MULTILINE)


@pytest.fixture(scope="module")
def hooks() -> list[dict[str, Any]]:
    (repo,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    # Others are fetched from elsewhere.
    assert repo["repo"] == "local"
    found: list[dict[str, Any]] = repo["hooks"]
    return found


def test_without_arguments_all_checks_run() -> None:
    (default,) = re.findall(r"\|\| set -- (.*)$", LINT, re.MULTILINE)
    assert default.split() == CHECKS == ["ruff", "imports", "types", "prose"]


def test_every_check_is_a_hook_on_the_whole_project(hooks: list[dict[str, Any]]) -> None:
    assert [hook["entry"] for hook in hooks] == [f"./deploy/lint {check}" for check in CHECKS]
    assert {hook["language"] for hook in hooks} == {"system"}
    assert not any(hook["pass_filenames"] for hook in hooks)


def test_the_tests_command_runs_all_checks_and_names_none_itself() -> None:
    test = (ROOT / "deploy/test").read_text()
    assert re.search(r"^\./deploy/lint$", test, re.MULTILINE)
    assert re.findall(r"\$python -m (\w+)|\$python -c", test) == ["pytest"] * 2


def test_a_check_that_passes_says_which_it_was() -> None:
    told = played(str(ROOT / "deploy/lint"), "imports")
    assert (told.returncode, told.stdout.splitlines()[0]) == (0, "== import-linter"), told.stderr


def test_an_unknown_check_is_refused_in_one_line() -> None:
    told = played(str(ROOT / "deploy/lint"), "mypy")
    assert told.returncode == 2
    assert told.stderr == (
        "lint: expected ruff, imports, types or prose, got mypy; ./deploy/lint runs them all\n"
    )
