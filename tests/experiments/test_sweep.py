"""Trials become a table; whatever interrupts a sweep, the table is the same."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess

import pytest

from experiments.studies.about import other_codes_in_words
from experiments.studies.study_file import read_study
from experiments.studies.sweep import _write_table, sweep
from experiments.studies.trial_table import read_trials, table_in_words
from experiments.studies.workers import play
from shared.errors import ConfigError
from shared.process.entry import python
from tests.processes import ended, until

BASE = """
description = "as short as it gets"
seeds = 2

[base]
duration = 0.05
push = []
link.network = "constant:0ms"

[grid]
controller = ["la", "pr"]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished sweep of BASE on one worker: its folder."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "short.toml").write_text(BASE)
    out = folder / "out"
    sweep(read_study(folder / "short.toml"), out=out)
    return out


@pytest.fixture
def again(finished, tmp_path):
    """A copy of it, to spoil."""
    return shutil.copytree(finished, tmp_path / "again")


def lines_of(out):
    return (out / "trials.jsonl").read_text().splitlines()


def test_two_workers_give_the_rows_of_one(finished, study_of, tmp_path):
    rows = sweep(study_of(BASE), out=tmp_path / "two", workers=2)
    assert rows == read_trials(finished).to_pylist()
    assert [(row["controller"], row["seed"]) for row in rows] == [
        ("la", 0), ("la", 1), ("pr", 0), ("pr", 1)
    ]  # fmt: skip
    assert {row["task_seconds"] for row in rows} == {0.05}
    assert [row["error"] for row in rows] == [None] * 4


def test_a_finished_sweep_plays_nothing_and_can_be_read(finished, study_of):
    before = (finished / "about.json").read_text()
    rows = sweep(study_of(BASE), out=finished)
    assert rows == read_trials(finished).to_pylist()
    assert len(lines_of(finished)) == 4
    assert (finished / "about.json").read_text() == before
    about, study = json.loads(before), read_study(finished)
    assert (about["played"], about["seeds"], study.name) == (4, 2, "short")
    assert study.trials == study_of(BASE).trials


def test_a_sweep_killed_after_its_last_trial_is_finished_by_the_next(again, study_of):
    table = read_trials(again)
    (again / "trials.parquet").unlink()
    (again / "about.json").unlink()
    sweep(study_of(BASE), out=again)
    assert read_trials(again) == table
    about = json.loads((again / "about.json").read_text())
    assert about["played"] == 0
    assert about["trial_seconds"] > 0


def test_a_sweep_cut_in_the_middle_of_a_line_goes_on_to_the_same_table(again, study_of):
    table = read_trials(again)
    (again / "trials.parquet").unlink()
    data = (again / "trials.jsonl").read_bytes()
    kept = data.splitlines(keepends=True)[:2]
    (again / "trials.jsonl").write_bytes(data[: len(b"".join(kept)) + 100])
    sweep(study_of(BASE), out=again)
    assert read_trials(again) == table
    assert [line.encode() + b"\n" for line in lines_of(again)[:2]] == kept
    assert len(lines_of(again)) == 4


def test_trials_of_other_settings_and_other_code_are_left_out(again, study_of, capsys):
    records = [json.loads(line) for line in lines_of(again)]
    for record in records:
        if record["label"]["controller"] == "pr":
            record["code"] = "other"
    text = "".join(json.dumps(record) + "\n" for record in records)
    (again / "trials.jsonl").write_text(text)

    rows = sweep(study_of(BASE), out=again, keep_code=True)
    assert len(rows) == len(lines_of(again)) == 4
    assert capsys.readouterr().err == ""
    # In the other study LA is as before and PR another trial, of which one seed is asked for.
    changed = BASE.replace(
        'controller = ["la", "pr"]', "sensors.joint_position_noise = [0.01, 0.5]"
    )
    rows = sweep(study_of(changed, seeds=1), out=again)
    assert "left out: 3 of other settings or seeds, 0 of other code" in capsys.readouterr().err
    assert [row["sensors.joint_position_noise"] for row in rows] == [0.01, 0.5]
    assert rows[0]["log_hash"] == records[0]["summary"]["log_hash"] != rows[1]["log_hash"]
    assert len(lines_of(again)) == 5

    # PR is not played again, because only LA is asked for.
    rows = sweep(study_of(BASE), out=again, only=["controller=la"])
    assert "left out: 1 of other settings or seeds, 2 of other code" in capsys.readouterr().err
    assert [row["controller"] for row in rows] == ["la", "la"]
    assert len(lines_of(again)) == 5


def test_trials_of_other_code_that_are_kept_are_told(again, study_of, tmp_path):
    *kept, _ = [json.loads(line) | {"code": "other"} for line in lines_of(again)]
    (again / "trials.jsonl").write_text("".join(json.dumps(line) + "\n" for line in kept))
    table = tmp_path / "table.txt"
    sweep(study_of(BASE), out=again, keep_code=True)
    about = json.loads((again / "about.json").read_text())
    assert about["other_code"] == {"other": 3}
    assert other_codes_in_words(about) == "3 trials of code other"
    _write_table(table, "", "short", again)
    assert ", 3 trials of code other, 20" in table.read_text()


def test_a_trial_that_fails_is_a_row(tmp_path, study_of):
    study = study_of(
        BASE.replace('controller = ["la", "pr"]', "walk.step_length = [9.0, 0.1]").replace(
            "duration", 'task = "walk"\nduration'
        ),
        seeds=1,
    )
    failed, played = sweep(study, out=tmp_path / "out")
    assert failed["error"].startswith("ConfigError: walk: ")
    assert "\n" not in failed["error"]
    assert (failed["fell"], failed["walk.step_length"]) == (None, 9.0)
    assert (played["error"], played["fell"]) == (None, False)
    assert read_trials(tmp_path / "out").to_pylist() == [failed, played]
    text = table_in_words([failed, played], ["walk.step_length"])
    assert "trials without a result: 1; the first: ConfigError: walk: " in text


def test_a_column_that_no_summary_has_is_an_error_that_lists_them(again, study_of):
    wrong = study_of('columns = ["commands.hold"]\n' + BASE)
    with pytest.raises(ConfigError, match=r"expected one of .*commands\.held, .*'commands\.hold'"):
        sweep(wrong, out=again)
    counted = study_of('columns = ["edge_solves.infeasible", "on_board_qps"]\n' + BASE)
    row = sweep(counted, out=again)[0]
    assert list(row) == [
        *("controller", "seed", "fell", "edge_solves.infeasible", "on_board_qps", "error")
    ]
    assert row["edge_solves.infeasible"] == 0


def test_all_active_sets_are_solved_where_the_study_asks_for_it(study_of):
    slow = "seeds = 1\n[base]\nduration = 0.05\nloop.edge_compute_ns = 5_000_000\n"
    known = []
    for text in (slow, "all_active_sets = true\n" + slow):
        (trial,) = study_of(text).trials
        summary = play(trial.config, trial.all_active_sets)["summary"]
        known.append(sum(summary["active_set_discrepancy"]["ticks"]))
    # The edge solves a state in 5 ms, of fifty that are sent.
    assert 0 < known[0] < 20
    assert known[1] == 50


def test_two_sweeps_do_not_write_to_one_folder(again, study_of):
    with (again / "trials.jsonl").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(ConfigError, match="another sweep writes to"):
            sweep(study_of(BASE), out=again)


def test_ctrl_c_keeps_what_is_finished(tmp_path):
    path, out = tmp_path / "long.toml", tmp_path / "out"
    # After a short trial one that takes hours.
    path.write_text(BASE.replace('controller = ["la", "pr"]', "duration = [0.05, 36000.0]"))
    sweeps = ("experiments", "sweep", str(path), "--out", str(out), "--workers", "1")
    # A shell's background jobs ignore the signal; so may whoever runs the tests.
    restore = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    process = subprocess.Popen(
        python("-m", *sweeps),
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=restore,
        start_new_session=True,
    )
    journal = out / "trials.jsonl"
    try:
        until(
            lambda: process.poll() is not None or (journal.is_file() and journal.stat().st_size),
            "no trial is finished",
        )
        os.killpg(process.pid, signal.SIGINT)
        # Ends its worker instead of waiting for it.
        assert ended(process) == 130
        _, told = process.communicate()
    finally:
        process.kill()
    # A line of progress comes every 10 s, so a slow start has one.
    *progress, message = told.splitlines()
    assert message == f"interrupted; the same command continues in {out}"
    assert all(line.startswith("trials ") for line in progress)
    assert all(json.loads(line)["error"] is None for line in lines_of(out))
