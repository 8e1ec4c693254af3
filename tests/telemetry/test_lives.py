from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.errors import ConfigError
from shared.telemetry.lives import begin_life, lives, recover
from shared.telemetry.parquet import read_parquet
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import Column, Schema

SCHEMA = Schema(Column("n", kind="int64"))


def killed_life(run: Path, *values: float) -> None:
    """The file of a process that was killed after it has written some rows."""
    log = RowLog(SCHEMA, path=run / "edge.rows")
    for value in values:
        log.row()[0] = value
    log.close()


def test_each_life_keeps_its_files_and_has_its_number(tmp_path: Path):
    for value in range(12):
        begin_life(tmp_path, "edge")
        killed_life(tmp_path, value)
    assert lives(tmp_path, "edge") == [*(f"edge.{number}" for number in range(1, 12)), "edge"]
    recover(tmp_path, "edge")
    for number in range(1, 12):
        _, rows = read_parquet(tmp_path / f"edge.{number}.parquet")
        np.testing.assert_array_equal(rows, [[number - 1]])
    _, rows = read_parquet(tmp_path / "edge.parquet")
    np.testing.assert_array_equal(rows, [[11]])
    assert not list(tmp_path.glob("*.rows"))


def test_files_of_others_are_no_lives(tmp_path: Path):
    for name in ("edge.log", "edge2.json", "edge.one.json", "edge.1.2.json", "link.json"):
        (tmp_path / name).touch()
    assert lives(tmp_path, "edge") == []
    begin_life(tmp_path, "edge")
    assert (tmp_path / "edge.log").exists()


def test_a_report_without_rows_is_a_life_too(tmp_path: Path):
    (tmp_path / "edge.json").write_text("{}")
    begin_life(tmp_path, "edge")
    assert lives(tmp_path, "edge") == ["edge.1"]


def test_a_process_that_lives_keeps_its_file(tmp_path: Path):
    log = RowLog(SCHEMA, path=tmp_path / "edge.rows")
    log.row()[0] = 7.0
    recover(tmp_path, "edge")
    with pytest.raises(ConfigError, match="to which another one writes; end it, or try"):
        begin_life(tmp_path, "edge")
    log.close()
    recover(tmp_path, "edge")
    _, rows = read_parquet(tmp_path / "edge.parquet")
    np.testing.assert_array_equal(rows, [[7.0]])


def test_a_file_of_rows_that_is_none_is_left_alone(tmp_path: Path):
    (tmp_path / "edge.rows").write_bytes(b"mine")
    recover(tmp_path, "edge")
    assert [file.name for file in tmp_path.iterdir()] == ["edge.rows"]
