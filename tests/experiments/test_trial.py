"""The command `trial`: its files, and files of other runs that it does not replace."""

from __future__ import annotations

import json

import pytest

from experiments.trial import add_trial_arguments, run_trial
from shared.errors import ConfigError
from shared.process.cli import Parser
from shared.telemetry.parquet import parquet_shape
from shared.telemetry.schema import STEP_SCHEMA

SHORT = ("--duration", "0.02", "--push", "none", "--network", "constant:1ms")


def trial(*typed):
    parser = Parser(prog="trial")
    add_trial_arguments(parser)
    return run_trial(parser.parse_args([*SHORT, *map(str, typed)]))


def test_a_trial_says_where_its_files_are(tmp_path, capsys):
    assert trial("--out", tmp_path / "run") == 0
    assert f"files: {tmp_path / 'run'}" in capsys.readouterr().out
    assert (tmp_path / "run" / "summary.json").is_file()


def test_a_trial_without_a_folder_says_that_it_keeps_no_files(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert trial() == 0
    assert "no files; --out DIR keeps them" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_the_printed_json_is_json_alone(capsys):
    assert trial("--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["fell"] is False


def test_the_files_of_another_run_are_not_replaced(tmp_path):
    folder, file = tmp_path / "run", tmp_path / "summary.json"
    assert trial("--out", folder, "--json", file) == 0
    before = (folder / "config.toml").read_bytes(), file.read_bytes()
    with pytest.raises(ConfigError, match="out: expected a new or empty folder"):
        trial("--seed", "3", "--out", folder)
    with pytest.raises(ConfigError, match="json: expected a new file"):
        trial("--seed", "3", "--json", file)
    assert before == ((folder / "config.toml").read_bytes(), file.read_bytes())
    assert trial("--seed", "3", "--out", folder, "--json", file, "--force") == 0
    assert "seed = 3" in (folder / "config.toml").read_text()


def test_only_a_trial_with_steps_by_touch_has_a_table_of_footprints(tmp_path):
    settings = tmp_path / "stepping.toml"
    settings.write_text('[wbc.balance]\nlaw = "dcm"\n')
    assert trial("--config", settings, "--out", tmp_path / "timed") == 0
    assert not (tmp_path / "timed" / "steps.parquet").exists()
    stepping = ("--controller", "lc", "--stepping", "on")
    assert trial("--config", settings, *stepping, "--out", tmp_path / "steps") == 0
    schema, count = parquet_shape(tmp_path / "steps" / "steps.parquet")
    assert schema.columns == STEP_SCHEMA.columns
    # The feet as the robot begins.
    assert count == 2
