"""This checkout beside another commit: the table has its rows, and nothing is left behind."""

from __future__ import annotations

import subprocess
from typing import Any

import numpy as np
import pytest

from benchmarks import against
from benchmarks.timing import Ratio
from shared.errors import UserError
from tests.processes import ROOT


def git(*arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True
    ).stdout


@pytest.fixture
def repository() -> None:
    try:
        git("rev-parse", "HEAD")
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("this is no git repository")


def test_a_ratio_is_that_of_the_rounds():
    ours = [np.array([1.0, 1.0, 1.0]), np.array([20.0, 20.0, 40.0])]
    others = [np.array([2.0, 2.0, 2.0]), np.array([20.0, 20.0, 20.0])]
    ratio = Ratio.of(ours, others)
    assert (ratio.p50, ratio.least, ratio.most) == (0.75, 0.5, 1.0)
    assert ratio.p99 > 1.0
    assert ratio.p50_text == "0.75 (0.50–1.00)"


def test_a_commit_that_is_not_there_is_refused_in_a_line(repository):
    with pytest.raises(UserError, match="--against: git rev-parse") as refused:
        against.run("no-such-commit", rounds=1, seconds=0.2)
    assert "\n" not in str(refused.value)


def test_the_table_has_a_line_for_every_trial_and_leaves_no_checkout(repository, monkeypatch):
    played: list[tuple[Any, ...]] = []

    def made_up(side, task, controller, *, seconds):
        assert (side.folder / "shared").is_dir()
        played.append((side.folder, task, controller, seconds))
        if seconds is None:
            return {"trial": np.array([60.0])}
        return {name: np.array([1.0 + (side.folder == ROOT)]) for name in against._TICK}

    monkeypatch.setattr(against._Side, "play", made_up)
    monkeypatch.setattr(against, "start_up_ns", lambda module, folder: 5)
    monkeypatch.setattr(against, "header", lambda: "a machine")
    before = git("worktree", "list")
    lines = against.run("HEAD", rounds=2, seconds=0.5).splitlines()
    assert git("worktree", "list") == before
    assert lines[0].startswith("a machine; other: ")
    table = lines[4:]
    assert len(table) == len(against.TRIALS) * len(against._TICK) + 2
    assert table[0].split() == ["balance", "PR,", "measure", "2.00", "2.00–2.00", "2.00"]
    assert table[-2].split() == [
        "walk",
        "LA,",
        "whole",
        "trials",
        "a",
        "minute",
        "1.00",
        "1.00–1.00",
    ]
    ours, others = (
        [each[1:] for each in played if (each[0] == ROOT) is own] for own in (True, False)
    )
    assert ours == others
    assert [each[0] == ROOT for each in played[:4]] == [True, False, True, False]


def test_another_checkout_plays_by_its_own_modules(repository):
    with against._checked_out("HEAD") as (_, folder), against._side(folder) as side:
        # A mark by which it can be told that its module was played.
        node = folder / "robot_node" / "node.py"
        node.write_text(node.read_text() + "\nraise SystemExit(0)\n")
        with pytest.raises(UserError, match="cannot play balance with la"):
            side.play("balance", "la", seconds=0.2)


def test_a_checkout_gives_the_parts_of_its_ticks(repository):
    with against._side(ROOT) as side:
        played = side.play("balance", "la", seconds=0.2)
    assert set(played) == set(against._TICK)
    assert {len(played[name]) for name in against._TICK[:-1]} == {len(played["measure"])}
    assert np.all(played["tick"] >= played["measure"])
