"""`check` plays trials again and finds a row that is not what they come to."""

from __future__ import annotations

import argparse
import json
import shutil

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from experiments.studies.check import add_check_arguments, changed, difference, matched, run_check
from experiments.studies.code_identity import ROOT, code_version
from experiments.studies.rounding import beyond, differences
from experiments.studies.study_file import read_study
from experiments.studies.sweep import sweep
from experiments.studies.trial_table import read_trials
from shared.errors import ConfigError
from shared.output.versions import versions
from shared.process.native_libraries import AVX2, KERNEL

PUBLISHED = ROOT / "docs/results/trials"

STUDY = """
seeds = 2
columns = ["fell", "com_error_m", "realtime_factor", "active_set_discrepancy.ticks", "log_hash"]
all_active_sets = true

[base]
duration = 0.05
push = []

[grid]
link.network = ["constant:0ms", "generated:factory"]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a finished sweep, without its journal."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "short.toml").write_text(STUDY)
    sweep(read_study(folder / "short.toml"), out=folder / "out")
    (folder / "out" / "trials.jsonl").unlink()
    return folder / "out"


@pytest.fixture
def folder(finished, tmp_path):
    """A copy of it, to spoil."""
    return shutil.copytree(finished, tmp_path / "spoilt")


def check(folder, *options):
    parser = argparse.ArgumentParser()
    add_check_arguments(parser)
    return run_check(parser.parse_args([str(folder), "--workers", "1", *options]))


def spoil(folder, **cells):
    """Other values in row 2, by the names of their columns."""
    rows = read_trials(folder).to_pylist()
    rows[2].update({name.replace("__", "."): value for name, value in cells.items()})
    pq.write_table(pa.Table.from_pylist(rows), folder / "trials.parquet")


def test_an_untouched_sweep_is_identical_from_its_table_alone(finished, capsys):
    assert check(finished, "--sample", "9") == 0
    assert "4 of 4 trials played again" in capsys.readouterr().out


def test_a_changed_cell_is_named_with_its_row_whatever_the_code(folder, capsys):
    rows = read_trials(folder).to_pylist()
    ticks = rows[2]["active_set_discrepancy.ticks"]
    spoil(
        folder,
        com_error_m=rows[2]["com_error_m"] * (1 + 1e-15),
        active_set_discrepancy__ticks=[ticks[0] + 1, *ticks[1:]],
        realtime_factor=99.0,  # measured: not compared
    )
    played_by_other_code(folder)
    assert check(folder, "--sample", "4", "--seed", "1", "--exact") == 1
    shown = capsys.readouterr()
    assert "expected to the last bit" in shown.out
    (line,) = (line for line in shown.out.splitlines() if line.startswith("row "))
    assert line.startswith("row 2 (link.network=generated:factory, seed=0) differs: com_error_m is")
    assert f"active_set_discrepancy.ticks is {[ticks[0] + 1, *ticks[1:]]}, played again" in line
    assert "realtime_factor" not in line
    assert "4 of 4 trials played again (--seed 1): rows that differ: 1" in shown.out


def test_of_other_code_rows_agree_within_tolerances(folder, capsys):
    com_error_m = read_trials(folder).to_pylist()[2]["com_error_m"]
    spoil(folder, com_error_m=com_error_m * (1 + 1e-5), log_hash="of other bits")
    played_by_other_code(folder)
    assert check(folder, "--sample", "4") == 0
    shown = capsys.readouterr().out
    assert f"code other of commit {'0' * 10}" in shown
    assert f"there, {code_version()} here" in shown
    assert "rows that differ by rounding alone: 1" in shown
    spoil(folder, com_error_m=com_error_m + 0.001)
    assert check(folder, "--sample", "4") == 1


def played_by_other_code(folder):
    about = json.loads((folder / "about.json").read_text())
    changed = {"code": "other", "commit": "0" * 40}
    (folder / "about.json").write_text(json.dumps(about | changed))


def test_a_row_of_no_trial_differs_without_being_played(folder, capsys):
    spoil(folder, seed=7)
    assert check(folder, "--sample", "1", "--seed", "0") == 1
    shown = capsys.readouterr().out
    assert "row 2 (link.network=generated:factory, seed=7) differs: the study has no such" in shown
    assert "1 of 4 trials played again" in shown


def test_a_sample_is_drawn_by_its_seed(finished, capsys, monkeypatch):
    drawn = []

    def replayed(study, rows, trials, workers, *, exact):
        drawn.append(sorted(trials))
        return []

    monkeypatch.setattr("experiments.studies.check.replayed", replayed)
    for seed in [*range(60), 3]:
        assert check(finished, "--sample", "2", "--seed", str(seed)) == 0
    assert drawn[-1] == drawn[3]
    assert {tuple(numbers) for numbers in drawn} == {
        (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)
    }  # fmt: skip
    # Without a seed it says which one to repeat it with.
    check(finished)
    assert "(--seed " in capsys.readouterr().out.splitlines()[-1]


def test_rows_of_a_bisection_after_a_changed_outcome_are_none_of_its_trials(study_of):
    study = study_of(
        """
        seeds = 1
        [bisect]
        setting = "loop.edge_compute_ns"
        value = 1
        high = 64
        resolution = 8
        """
    )
    rows = [
        {"loop.edge_compute_ns": at, "seed": 0, "fell": at > 20, "error": None}
        for at in (64, 32, 16, 24)
    ]
    trials, strangers = matched(study, rows)
    asked = [trials[k].config.loop.edge_compute_ns for k in range(4)]
    assert (asked, strangers) == ([64, 32, 16, 24], [])
    rows[1]["fell"] = False
    trials, strangers = matched(study, rows)
    assert sorted(trials) == [0, 1]
    assert [stranger.number for stranger in strangers] == [2, 3]


def message(row, again):
    return difference(row, again, changed(row, again))


def test_a_column_in_one_row_only_is_a_difference():
    assert message({"a": 1, "b": [1, None]}, {"a": 1, "b": [1, None]}) == ""
    assert message({"a": 1}, {"a": 1, "c": None}) == "c is missing, played again None"
    assert message({"a": 1, "c": 2}, {"a": 1}) == "c is 2, played again missing"
    assert message({"robot_tick_ms.p50": 1.0}, {"robot_tick_ms.p50": 2.0}) == ""


def rounded_there(folder, **versions):
    """As if the sweep had been played where sums are rounded otherwise."""
    about = json.loads((folder / "about.json").read_text())
    about["versions"] |= versions
    (folder / "about.json").write_text(json.dumps(about))


def test_where_sums_are_rounded_otherwise_small_differences_are_told_with_the_reason(
    folder, capsys
):
    com_error_m = read_trials(folder).to_pylist()[2]["com_error_m"]
    spoil(folder, com_error_m=com_error_m * (1 + 1e-4), log_hash="of other bits")
    assert check(folder, "--sample", "4") == 1
    rounded_there(folder, blas="SkylakeX")
    capsys.readouterr()
    assert check(folder, "--sample", "4") == 0
    shown = capsys.readouterr().out
    assert f"blas SkylakeX there, {versions()['blas']} here" in shown
    assert (
        "row 2 (link.network=generated:factory, seed=0) differs by rounding: com_error_m" in shown
    )
    assert "rows that differ by rounding alone: 1" in shown


def test_rounding_explains_neither_another_outcome_nor_a_large_difference(folder, capsys):
    rounded_there(folder, instructions="aarch64")
    com_error_m = read_trials(folder).to_pylist()[2]["com_error_m"]
    spoil(folder, com_error_m=com_error_m + 0.001)
    assert check(folder, "--sample", "4") == 1
    assert "seed=0) differs: com_error_m" in capsys.readouterr().out
    spoil(folder, com_error_m=com_error_m, fell=True)
    assert check(folder, "--sample", "4") == 1
    assert "seed=0) differs: fell is True" in capsys.readouterr().out


def test_of_a_fall_only_its_time_is_compared_where_sums_are_rounded_otherwise():
    row = {"fell": True, "task_seconds": 1.5, "com_error_m": 3.0}
    again = {"fell": True, "task_seconds": 1.501, "com_error_m": 0.4}
    assert beyond(row, again, changed(row, again)) == []
    again["task_seconds"] = 1.6
    assert beyond(row, again, changed(row, again)) == ["task_seconds"]


def test_published_sweeps_round_as_every_process_of_ours_does_on_a_processor_with_avx2():
    for about in sorted(PUBLISHED.glob("*/about.json")):
        recorded = json.loads(about.read_text())["versions"]
        here = versions()
        if (here["instructions"], here["blas"]) != (AVX2, KERNEL):
            pytest.skip(f"{here['blas']} on {here['instructions']}: compared with a tolerance")
        assert differences({"versions": here | recorded}) == []


@pytest.mark.parametrize(
    ("file", "text", "shown"),
    [
        ("about.json", None, "without an about.json that names its code"),
        ("about.json", "[]", "without an about.json that names its code"),
        ("trials.parquet", None, "no trials.parquet"),
        ("trials.parquet", "PAR1", "cannot read "),
        ("study.toml", "seeds =", "is not valid TOML"),
    ],
)
def test_what_is_no_finished_sweep_is_refused_in_one_line(folder, file, text, shown):
    (folder / file).unlink()
    if text is not None:
        (folder / file).write_text(text)
    with pytest.raises(ConfigError) as caught:
        check(folder)
    assert shown in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("option", ["--sample=0", "--seed=-1", "--workers=0"])
def test_numbers_that_cannot_be_are_refused(finished, option):
    with pytest.raises(ConfigError, match=f"{option[:-2].rstrip('=')}: expected at least"):
        check(finished, option)
