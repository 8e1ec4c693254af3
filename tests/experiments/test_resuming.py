"""A bisection that is interrupted and gone on with ends with the table of one that was not."""

from __future__ import annotations

import contextlib
import itertools
import random
import signal
import subprocess

import pytest

from experiments.studies.bisection import limits
from experiments.studies.study_file import read_study
from experiments.studies.sweep import sweep
from experiments.studies.trial_table import read_trials
from shared.errors import ConfigError
from shared.process.entry import python
from tests.processes import ended, until

BISECT = """
seeds = 3
columns = ["fell", "at"]
[grid]
controller = ["la", "pr"]
[bisect]
setting = "loop.edge_compute_ns"
value = 1
high = 100
resolution = 5
"""
# Where each seed of a controller falls: nowhere, at once, and in between.
ENDS = {"la": (100, 0, 61), "pr": (13, 55, 99)}
# Real trials: 1600 N and 800 N throw every robot, 400 N does not.
PLAYED = """
seeds = 2
columns = ["fell", "log_hash"]
[base]
duration = 0.25
link.network = "constant:0ms"
[bisect]
setting = "push"
value = ["{}N@0.01s:0.1s:+y"]
high = 1600
resolution = 400
"""


class Oracle:
    """Plays in no time and in any order, knows who falls, and is interrupted after some trials."""

    number = 1

    def __init__(self, *, order=None, interrupted_after=None, broken=()):
        self.played, self.largest_queue = [], 0
        self._waiting, self._order, self._broken = [], order or random.Random(0), broken
        self._left = interrupted_after

    def submit(self, trial):
        self._waiting.append(trial)
        self.largest_queue = max(self.largest_queue, len(self._waiting))

    def finished(self):
        if self._left is not None:
            self._left -= 1
            if self._left < 0:
                raise KeyboardInterrupt
        trial = self._waiting.pop(self._order.randrange(len(self._waiting)))
        at, label = trial.config.loop.edge_compute_ns, trial.label
        self.played.append((label["controller"], label["seed"], at))
        fell = at > ENDS[label["controller"]][label["seed"]]
        broken = self.played[-1] in self._broken
        return trial, {
            "summary": None if broken else {"fell": fell, "at": at},
            "error": "Error: x" if broken else None,
            "wall_seconds": 0.0,
        }


@pytest.fixture
def play(monkeypatch, study_of, tmp_path):
    """A sweep of BISECT played by an oracle; returns its rows."""

    def played(oracle, *, out="out", **options):
        monkeypatch.setattr(
            "experiments.studies.sweep.players", lambda *_: contextlib.nullcontext(oracle)
        )
        return sweep(study_of(BISECT), out=tmp_path / out, **options)

    return played


def test_a_bisection_has_the_same_rows_in_whatever_order_its_trials_finish(play, study_of):
    first = Oracle(order=random.Random(1))
    rows = play(first)
    assert first.largest_queue == 6  # all cells and seeds at the same time, one trial of each
    assert [row["at"] for row in rows if (row["controller"], row["seed"]) == ("la", 2)] == [
        100, 50, 75, 62, 56, 59
    ]  # fmt: skip
    assert [(limit.standing, limit.falling) for limit in limits(study_of(BISECT), rows)] == [
        (100, None), (0, 3), (59, 62), (12, 15), (53, 56), (96, 100)
    ]  # fmt: skip
    assert play(Oracle(order=random.Random(2)), out="other") == rows


def test_a_bisection_interrupted_after_any_trial_goes_on_to_the_same_table(play, tmp_path):
    whole = Oracle()
    rows = play(whole, out="whole")
    table = read_trials(tmp_path / "whole")
    assert len(rows) == len(whole.played) > 20
    # At its beginning, in its middle and before its end.
    for k in (0, 1, *range(2, len(rows), 5), len(rows) - 1):
        cut, rest = Oracle(interrupted_after=k), Oracle(order=random.Random(k))
        with pytest.raises(KeyboardInterrupt):
            play(cut, out=str(k))
        assert not (tmp_path / str(k) / "trials.parquet").exists()
        assert play(rest, out=str(k)) == rows
        assert read_trials(tmp_path / str(k)) == table
        # Nothing is played twice, and nothing that was not asked for.
        assert len(cut.played) == k
        assert sorted(cut.played + rest.played) == sorted(whole.played)


def test_an_error_ends_a_bisection_until_the_next_time(play):
    broken = ("la", 2, 75)
    rows = play(Oracle(broken=[broken]))
    mine = [row for row in rows if (row["controller"], row["seed"]) == ("la", 2)]
    assert [(row["loop.edge_compute_ns"], row["error"]) for row in mine] == [
        (100, None), (50, None), (75, "Error: x")
    ]  # fmt: skip
    again = Oracle()
    assert play(again) == play(Oracle(), out="other")
    assert again.played == [("la", 2, 75), ("la", 2, 62), ("la", 2, 56), ("la", 2, 59)]


def test_only_some_cells_of_a_bisection_can_be_played(play):
    pr = Oracle()
    rows = play(pr, only=["controller=pr"])
    assert {row["controller"] for row in rows} == {"pr"}
    rest = Oracle()
    assert play(rest) == play(Oracle(), out="other")
    assert {controller for controller, _, _ in rest.played} == {"la"}


def test_the_progress_of_a_bisection_counts_down_to_its_end(play, monkeypatch):
    message = []
    monkeypatch.setattr(
        "experiments.studies.progress.Progress.finished",
        lambda self, *, fell, left: message.append((fell, left)),
    )
    whole = Oracle()
    play(whole)
    # At most 100 and five halvings each.
    assert message[0][1] < 6 * 6
    assert all(after < before for (_, before), (_, after) in itertools.pairwise(message))
    assert message[-1][1] == 0
    assert len(message) == len(whole.played)


def test_lines_of_another_bisection_are_left_out_and_counted(play, study_of, tmp_path, capsys):
    total = len(play(Oracle()))
    capsys.readouterr()
    finer = study_of(BISECT.replace("resolution = 5", "resolution = 60"))
    rows = sweep(finer, out=tmp_path / "out")
    assert len(rows) < total
    assert f"{total - len(rows)} of other settings or seeds, 0 of other" in capsys.readouterr().err


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The rows of PLAYED, played through."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    (folder / "played.toml").write_text(PLAYED)
    return sweep(read_study(folder / "played.toml"), out=folder / "out")


def test_real_trials_are_bisected(uninterrupted):
    assert [(row["push"], row["seed"], row["fell"]) for row in uninterrupted] == [
        ([f"{force}N@0.01s:0.1s:+y"], seed, force > 400)
        for seed in (0, 1)
        for force in (1600, 800, 400)
    ]


def test_a_bisection_killed_in_the_middle_goes_on_to_the_same_table(tmp_path, uninterrupted):
    path, out = tmp_path / "played.toml", tmp_path / "out"
    path.write_text(PLAYED)
    sweeps = ("experiments", "sweep", str(path), "--out", str(out), "--workers", "1")
    process = subprocess.Popen(
        python("-m", *sweeps), stderr=subprocess.DEVNULL, start_new_session=True
    )
    journal = out / "trials.jsonl"
    try:
        until(
            lambda: process.poll() is not None or (journal.is_file() and journal.stat().st_size),
            "no trial is finished",
        )
        # A Ctrl-C is one of the tests of sweeps.
        process.kill()
        code = ended(process)
    finally:
        process.kill()
    assert code == -signal.SIGKILL
    kept = journal.read_bytes().splitlines(keepends=True)
    assert 1 <= len(kept) < len(uninterrupted)
    assert not (out / "trials.parquet").exists()
    rows = sweep(read_study(path), out=out)
    assert rows == uninterrupted == read_trials(out).to_pylist()
    lines = journal.read_bytes().splitlines(keepends=True)
    assert lines[: len(kept)] == kept
    assert len(lines) == len(rows)


def test_a_journal_that_is_none_is_an_error_in_one_line(play, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "trials.jsonl").write_text('{"trial": "x"}\n')
    with pytest.raises(ConfigError, match=r"in every line of .*trials\.jsonl, got another"):
        play(Oracle())


def test_a_changed_controller_file_is_played_again(study_of, tmp_path):
    file = tmp_path / "mine.py"
    text = "from examples.own_controller import LastSolution\nclass Mine(LastSolution): gain = {}\n"
    base = f'seeds = 1\n[base]\nduration = 0.02\npush = []\ncontroller = "{file}:Mine"\n'
    identities = []
    for gain in (1, 1, 2):
        file.write_text(text.format(gain))
        (trial,) = study_of(base).trials
        identities.append(trial.identity)
    assert identities[0] == identities[1] != identities[2]
