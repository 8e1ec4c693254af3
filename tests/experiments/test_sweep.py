"""Studies become trials, trials a table; whatever interrupts a sweep, the table is the same."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from experiments.dealing import draw
from experiments.study import SHIPPED, read_study
from experiments.sweep import sweep
from experiments.trial_table import read_trials, table_in_words, wilson_interval
from netem.networks import shipped_names
from shared.errors import ConfigError

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
PUSH = {"kind": "push", "force": 40.0, "duration": 0.2, "start": [1.0, 6.0], "directions": ["+x"]}


@pytest.fixture
def study_of(tmp_path):
    """A study from TOML text."""

    def build(text, **options):
        path = tmp_path / "short.toml"
        path.write_text(text)
        return read_study(path, **options)

    return build


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


def shown(study):
    return [cell.shown for cell in study.cells]


def test_every_combination_of_the_grid_with_every_named_cell_is_a_cell(study_of):
    study = study_of(
        """
        [base]
        task = "walk"
        "walk.steps" = 4
        [grid]
        controller = ["la", "pr"]
        [grid.link]
        network = ["constant:3ms", "constant:5ms"]
        [[cells]]
        name = "short"
        walk.step_length = 0.05
        [[cells]]
        name = "as it is"
        """
    )
    assert len(study.cells) == 2 * 2 * 2
    assert shown(study)[1] == {
        "cell": "short", "controller": "la", "link.network": "constant:5ms"
    }  # fmt: skip
    assert study.cells[-1].settings == {
        "task": "walk", "walk.steps": 4, "controller": "pr", "link.network": "constant:5ms"
    }  # fmt: skip
    # What varies is in every row, with its default where a cell does not set it.
    assert {trial.label["walk.step_length"] for trial in study.trials} == {0.05, 0.1}
    assert len({trial.identity for trial in study.trials}) == 8 * study.seeds


def test_without_grid_and_cells_there_is_one_cell(study_of):
    study = study_of("seeds = 3")
    assert [trial.label for trial in study.trials] == [{"seed": k} for k in range(3)]
    assert str(study.cells[0]) == "the only cell"


def test_a_value_may_be_a_list_in_the_base_and_in_the_grid(study_of):
    push = '"100N@1.0s:0.2s:+y"'
    in_base = study_of(f"[base]\npush = [{push}]")
    in_grid = study_of(f"[grid]\npush = [[{push}], []]")
    pushes = [trial.config.push for trial in in_grid.trials[:2]]
    assert pushes == [("100N@1.0s:0.2s:+y",), ()]
    assert in_base.trials[0].config.push == pushes[0]
    assert in_grid.cells[1].names == ["push=none"]


def test_seed_k_gets_the_kth_profile_and_after_the_last_the_first_again(study_of):
    names = [name for name in shipped_names() if name.startswith("factory/")]
    study = study_of(f'seeds = {len(names) + 1}\n[grid]\nlink.network = ["profiles:factory"]')
    networks = [trial.config.link.network for trial in study.trials]
    assert networks == [*names, names[0]]
    first, last = study.trials[0], study.trials[-1]
    assert (first.config.seed, last.config.seed) == (0, len(names))
    assert first.label["link.network"] == "profiles:factory"


def test_draws_depend_on_the_seed_and_the_setting_alone(study_of):
    random = (
        '[random]\npush = { kind = "push", force = 40.0, duration = 0.2, start = [1.0, 6.0], '
        'directions = ["+x"] }\n'
    )
    friction = 'plant.friction = { kind = "uniform", low = 0.4, high = 1.0 }\n'
    alone = study_of("seeds = 4\n" + random)
    among = study_of("seeds = 9\n[grid]\ntask = ['balance', 'walk']\n" + random + friction)
    for trial in among.trials:
        assert list(trial.config.push) == draw("push", PUSH, seed=trial.config.seed)
        assert 0.4 <= trial.config.plant.friction < 1.0
    pushes = [trial.config.push for trial in alone.trials]
    assert pushes == [trial.config.push for trial in among.trials if trial.cell == 0][:4]
    assert len(set(pushes)) == 4
    assert alone.trials[1].label["push"] == list(pushes[1])


def test_a_draw_is_what_it_was_last_year():
    assert draw("push", PUSH, seed=3) == ["40.000N@1.659s:0.200s:+x"]


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


def test_a_name_that_no_cell_has_lists_those_there_are(study_of):
    study = study_of(BASE)
    assert study.only(["controller=pr"]) == {1}
    with pytest.raises(ConfigError, match=r"expected one of controller=la, controller=pr; got 'x'"):
        study.only(["x"])


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
    assert "ended with an error: 1, the first: ConfigError: walk: " in text


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


def test_two_sweeps_do_not_write_to_one_folder(again, study_of):
    with (again / "trials.jsonl").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(ConfigError, match="another sweep writes to"):
            sweep(study_of(BASE), out=again)


def test_ctrl_c_keeps_what_is_finished(tmp_path):
    path, out = tmp_path / "long.toml", tmp_path / "out"
    # After a short trial one that takes many seconds.
    path.write_text(BASE.replace('controller = ["la", "pr"]', "duration = [0.05, 60.0]"))
    command = [sys.executable, "-m", "experiments", "sweep", path, "--out", out, "--workers", "1"]
    # A shell's background jobs ignore the signal; so may whoever runs the tests.
    restore = lambda: signal.signal(signal.SIGINT, signal.default_int_handler)  # noqa: E731
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, preexec_fn=restore, start_new_session=True
    )
    try:
        while process.poll() is None and not (
            out.is_dir() and (out / "trials.jsonl").stat().st_size
        ):
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        interrupted = time.monotonic()
        _, said = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 130
    # Ends its worker instead of waiting for it; a loaded machine may need a second or two.
    assert time.monotonic() - interrupted < 5.0
    assert said == f"interrupted; the same command goes on with {out}\n"
    assert all(json.loads(line)["error"] is None for line in lines_of(out))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("seeds = 0", "seeds: expected how many, at least 1, got 0"),
        ("seeds = true", "seeds: expected how many, at least 1, got True"),
        ("seed = 3", "seed: unknown; valid here: name, description, seeds"),
        ("[base]\nseed = 3", "seed: not a setting of a study; say how many with seeds"),
        ("[base]\nwalk.stepp = 3", "the only cell: walk.stepp: unknown setting; valid here: steps"),
        ("base = 3", "base: expected a table of settings, got 3"),
        ("[base]\nlink.network = 'constant:1'", "expected a duration as in 30ms"),
        ("[base]\nlink.network = 'profiles:x'", "expected one of profiles:building, profiles:fac"),
        ("[base]\n'walk.steps' = 1\nwalk.steps = 2", "base.walk.steps: expected once, got it twic"),
        ("[grid]", "grid: expected lists of values, got an empty table"),
        ("[grid]\ntask = []", "grid.task: expected a list of different values, got []"),
        ("[grid]\ntask = 'walk'", "grid.task: expected a list of different values, got 'walk'"),
        ("[grid]\nloop.hold_after = [1, 1]", "expected a list of different values, got [1, 1]"),
        ("[grid]\npush = ['1N@1s:1s:+x']", "push=1N@1s:1s:+x: push: expected a list of strings"),
        ("[grid]\ntask = ['walk']\n[[cells]]\nname = 'a'\ntask = 'walk'", "got it in two"),
        ("[[cells]]\ntask = 'walk'", "cells: expected a name of its own in each, got None"),
        ("[[cells]]\nname = 'a'\n[[cells]]\nname = 'b'\nwalk.x = 1", "b: walk.x: unknown setting"),
        ("columns = 'fell'", "columns: expected a list of fields of a summary, got 'fell'"),
        ("[random]\npush = 3", "random.push: expected { kind = "),
        (
            "[random]\nloop.hold_after = { kind = 'uniform', low = 1 }",
            "random.loop.hold_after: exp",
        ),
        ("[random]\npush = { kind = 'gust' }", "random.push: expected { kind = "),
        ("seeds =", "is not valid TOML"),
    ],
)
def test_a_bad_study_is_an_error_in_one_line(study_of, text, said):
    with pytest.raises(ConfigError) as caught:
        study_of(text)
    assert said in str(caught.value)
    assert "short" in str(caught.value)  # which study
    assert "\n" not in str(caught.value)


def test_an_unknown_study_lists_those_shipped():
    with pytest.raises(ConfigError, match=r"corrected-profiles, .*walk-constant.*got 'wolk'"):
        read_study("wolk")


@pytest.mark.parametrize("name", [file.stem for file in SHIPPED.glob("*.toml")])
def test_shipped_studies_can_be_played(name):
    study = read_study(name, seeds=1)
    assert len(study.trials) == len(study.cells)
    assert len({trial.identity for trial in study.trials}) == len(study.trials)
    assert study.table["description"]


def test_the_walk_over_constant_delays_has_a_computer_on_board_as_slow_as_the_link():
    trials = read_study("walk-constant", seeds=1).trials
    configs = [trial.config for trial in trials if trial.config.controller == "la"]
    delays = [config.link.network.partition(":")[2] for config in configs]
    assert delays == ["0ms", "3ms", "5ms", "25ms", "60ms"]
    for delay, config in zip(delays, configs, strict=True):
        assert config.switch.ready_after_ns(0) == int(delay.removesuffix("ms")) * 1_000_000


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe, Statistics in Medicine 17 (1998), Table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_intervals_are_those_published(successes, trials, low, high):
    # Published with four digits.
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)
    mirrored = wilson_interval(trials - successes, trials)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=5e-5)


def test_without_trials_nothing_is_known():
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_the_table_in_words_has_the_means_of_those_that_stand():
    def row(cell, com_error_m, *, fell=False):
        return {"cell": cell, "fell": fell, "com_error_m": com_error_m, "error": None}

    rows = [row("a", 0.01), row("a", 0.02), row("a", 9.0, fell=True), row("b", None, fell=True)]
    assert table_in_words(rows, ["cell"]).splitlines() == [
        "cell  stood  95 %     CoM error [cm]",
        "a     2/3    21–94 %  1.5",
        "b     0/1    0–79 %   -",
    ]
