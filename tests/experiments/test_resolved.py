"""`wbc config` prints settings that can be read back."""

from __future__ import annotations

import pytest

from experiments.resolved import add_config_arguments, run_config
from shared.config.config_file import load_config
from shared.process.cli import Parser


@pytest.fixture
def printed(capsys):
    def run(*typed):
        parser = Parser(prog="config")
        add_config_arguments(parser)
        assert run_config(parser.parse_args(typed)) == 0
        return capsys.readouterr().out

    return run


def test_what_is_printed_is_a_settings_file_of_the_same_run(printed, tmp_path):
    typed = ("--task", "walk", "--robot", "talos", "--outage", "3s@2s", "--loss", "0.25")
    overrides = {"task": "walk", "robot.name": "talos", "link.outage": ["3s@2s"], "link.loss": 0.25}
    expected = load_config(None, overrides)
    for number, more in enumerate(([], ["--changed"])):
        file = tmp_path / f"{number}.toml"
        file.write_text(printed(*typed, *more), encoding="utf-8")
        assert load_config(file) == expected


def test_only_what_differs_from_the_default_run(printed):
    assert printed("--changed") == ""
    assert printed("--changed", "--controller", "lc") == 'controller = "lc"\n'
