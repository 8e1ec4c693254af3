from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from deploy import outcome
from deploy.outcome import record, set_aside, summarise
from shared.config.settings import RunConfig
from shared.output.report import edge_report, robot_report
from shared.output.summary import summary_in_words
from shared.telemetry.lives import begin_life
from shared.telemetry.parquet import read_parquet, write_parquet
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA, Schema, tick_schema

TICKS = tick_schema(nq=38, nv=37)


def edge_life(run: Path, *, solve_ms: float, sent: int, refused: dict[str, int]) -> None:
    """The files of an edge that has solved `sent` states."""
    rows = np.zeros((sent, SOLVE_SCHEMA.width))
    rows[:, SOLVE_SCHEMA.slices["solve_ns"]] = solve_ms * 1e6
    write_parquet(SOLVE_SCHEMA, rows, run / "edge.parquet")
    report = edge_report(
        rows, statuses={"solved": sent}, sent=sent, received=sent + 1, lost=2, refused=refused
    )
    (run / "edge.json").write_text(json.dumps(report))


def robot_life(run: Path) -> None:
    rows = np.zeros((10, TICKS.width))
    write_parquet(TICKS, rows, run / "telemetry.parquet")
    report = robot_report(
        TICKS,
        rows,
        fell=False,
        wall_seconds=0.01,
        sent=10,
        received=8,
        lost=0,
        refused={},
        answers={},
        sensor_faults={},
        base_estimate={},
        torque_limits={},
    )
    (run / "telemetry.json").write_text(json.dumps(report))


def test_lives_of_a_service_that_was_started_again_count_together(tmp_path: Path):
    robot_life(tmp_path)
    edge_life(tmp_path, solve_ms=1.0, sent=100, refused={"stale": 1})
    begin_life(tmp_path, "edge")
    edge_life(tmp_path, solve_ms=5.0, sent=200, refused={"stale": 2, "config": 1})
    begin_life(tmp_path, "edge")
    edge_life(tmp_path, solve_ms=3.0, sent=10, refused={})
    result = summarise(tmp_path, RunConfig(), print)
    assert result is not None
    assert result["link"]["downlink"]["sent"] == 310
    assert result["link"]["uplink"]["lost"] == 6
    assert result["link"]["uplink"]["refused"] == {"stale": 3, "config": 1}
    assert result["edge_solves"] == {"solved": 310}
    assert result["edge_solve_ms"]["p50"] == 5.0
    assert json.loads((tmp_path / "summary.json").read_text())["fell"] is False
    # All ten ticks are the first one here, whose state the edges have solved.
    assert result["active_set_discrepancy"]["ticks"] == [10]
    # Its parts are in the summary; the rows stay.
    left = {file.name for file in tmp_path.iterdir()}
    rows = {"edge.1.parquet", "edge.2.parquet", "edge.parquet", "telemetry.parquet"}
    assert left == {"summary.json", *rows}


def test_a_table_that_was_not_written_to_its_end_is_left_out(tmp_path: Path):
    robot_life(tmp_path)
    edge_life(tmp_path, solve_ms=1.0, sent=100, refused={})
    begin_life(tmp_path, "edge")
    (tmp_path / "edge.parquet").write_bytes(b"PAR1")
    result = summarise(tmp_path, RunConfig(), print)
    assert result is not None
    assert result["edge_solves"] == {"solved": 100}
    assert result["active_set_discrepancy"]["ticks"] == [10]


def test_a_life_that_left_nothing_is_not_missed(tmp_path: Path):
    begin_life(tmp_path, "edge")
    assert list(tmp_path.iterdir()) == []
    assert summarise(tmp_path, RunConfig(), print) is None
    robot_life(tmp_path)
    result = summarise(tmp_path, RunConfig(), print)
    assert result is not None
    assert result["edge_solve_ms"]["p50"] is None


def killed_life(run: Path, stem: str, schema: Schema, count: int, **columns: float) -> None:
    """The rows of a process that was killed."""
    log = RowLog(schema, path=run / f"{stem}.rows")
    for number in range(count):
        row = log.row()
        row[0] = number
        for name, value in columns.items():
            row[schema.slices[name]] = value
    log.close()


def test_the_rows_of_an_edge_that_was_killed_count_too(tmp_path: Path):
    robot_life(tmp_path)
    killed_life(tmp_path, "edge", SOLVE_SCHEMA, 250, solve_ns=7e6, status=0)
    begin_life(tmp_path, "edge")
    edge_life(tmp_path, solve_ms=1.0, sent=100, refused={"stale": 1})
    result = summarise(tmp_path, RunConfig(), print, services={"edge": {"restarts": 1}})
    assert result is not None
    assert result["edge_solves"] == {"solved": 350}
    assert result["edge_solve_ms"]["p50"] == 7.0
    # What only the process knew is unknown; the rest is of the life that has told it.
    assert result["link"]["downlink"]["sent"] == 100
    assert result["services"] == {"edge": {"restarts": 1}}
    assert len(read_parquet(tmp_path / "edge.1.parquet")[1]) == 250
    assert not list(tmp_path.glob("*.rows"))


def test_a_run_that_was_killed_as_a_whole_has_a_summary_from_its_rows(tmp_path: Path):
    killed_life(tmp_path, "telemetry", TICKS, 300, com_error_m=0.25)
    killed_life(tmp_path, "edge", SOLVE_SCHEMA, 20)
    killed_life(tmp_path, "link", LINK_SCHEMA, 20, achieved_ns=5e6)
    killed_life(tmp_path, "steps", STEP_SCHEMA, 2)
    result = summarise(tmp_path, RunConfig(), print)
    assert result is not None
    assert result["fell"] is None
    assert (result["task_seconds"], result["com_error_m"]) == (0.3, 0.25)
    assert summary_in_words(result).startswith("Killed after 0.30 s of balance")
    assert json.loads((tmp_path / "summary.json").read_text())["task_seconds"] == 0.3
    left = {file.name for file in tmp_path.iterdir()}
    tables = {f"{stem}.parquet" for stem in ("telemetry", "edge", "link", "steps")}
    assert left == {"summary.json", *tables}


def test_a_summary_that_cannot_be_written_is_returned_and_the_reports_stay(tmp_path: Path):
    robot_life(tmp_path)
    (tmp_path / "summary.json").symlink_to("/dev/full")
    lines: list[str] = []
    result = summarise(tmp_path, RunConfig(), lines.append)
    assert result is not None
    assert len(lines) == 1
    assert "summary.json: No space left on device; free space" in lines[0]
    assert (tmp_path / "telemetry.json").exists()


def test_the_files_of_the_run_before_are_set_aside_once(tmp_path: Path):
    set_aside(tmp_path)
    assert list(tmp_path.iterdir()) == []
    for sent in (10, 20):
        edge_life(tmp_path, solve_ms=1.0, sent=sent, refused={})
        begin_life(tmp_path, "edge")
        (tmp_path / "summary.json").write_text(str(sent))
        set_aside(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["previous"]
    assert (tmp_path / "previous/summary.json").read_text() == "20"
    assert len(read_parquet(tmp_path / "previous/edge.1.parquet")[1]) == 20


def test_a_recording_that_is_not_written_is_given_up_and_one_that_works_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outcome, "_IDLE_SECONDS", 0.5)
    said: list[str] = []
    partial = tmp_path / "recording.rrd.partial"
    for text in ("import time; print('half'); time.sleep(3600)", BUSY):
        partial.touch()
        command = [sys.executable, "-c", text]
        monkeypatch.setattr(outcome, "python", lambda *words, command=command: command)
        record(tmp_path, said.append)
    assert said[0].startswith("no recording: expected rerun to write one, got no progress;")
    assert f"viewer record {tmp_path}" in said[0]
    assert said[1:] == ["whole"]


# Longer than the time for which a process may do nothing.
BUSY = """
import time
while time.process_time() < 1.5:
    pass
print("whole")
"""
