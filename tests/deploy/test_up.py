"""The folder of a run, which has the names of its task, controller and network."""

from __future__ import annotations

import re

import pytest

from deploy.up import _run_folder
from shared.config.config_file import load_config


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, "balance-la-factory-001"),
        ({"link.network": "constant:20ms"}, "balance-la-constant-20ms"),
        ({"link.network": "../mine.csv"}, "balance-la-mine.csv"),
        ({"controller": "mine.py:Mine:k=3:name=a/b"}, "balance-mine-k=3-name=a-b-factory-001"),
    ],
)
def test_the_folder_of_a_run_is_a_single_name(settings, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = _run_folder(None, load_config(None, settings), ("robot",))
    assert folder.parent.name == "runs"
    assert re.sub(r"^[0-9-]{16}", "", folder.name) == expected
