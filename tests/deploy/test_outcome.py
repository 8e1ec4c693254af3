from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from deploy.outcome import keep_report, summarise
from shared.config.settings import RunConfig
from shared.output.report import edge_report, robot_report
from shared.telemetry.parquet import write_parquet
from shared.telemetry.schema import SOLVE_SCHEMA, tick_schema

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
        wall_seconds=1.0,
        sent=10,
        received=8,
        lost=0,
        refused={},
        answers={},
        sensor_faults={},
    )
    (run / "telemetry.json").write_text(json.dumps(report))


def test_lives_of_a_service_that_was_started_again_count_together(tmp_path: Path):
    robot_life(tmp_path)
    edge_life(tmp_path, solve_ms=1.0, sent=100, refused={"stale": 1})
    keep_report(tmp_path, "edge")
    edge_life(tmp_path, solve_ms=5.0, sent=200, refused={"stale": 2, "config": 1})
    keep_report(tmp_path, "edge")
    edge_life(tmp_path, solve_ms=3.0, sent=10, refused={})
    result = summarise(tmp_path, RunConfig())
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
    keep_report(tmp_path, "edge")
    (tmp_path / "edge.parquet").write_bytes(b"PAR1")
    result = summarise(tmp_path, RunConfig())
    assert result is not None
    assert result["edge_solves"] == {"solved": 100}
    assert result["active_set_discrepancy"]["ticks"] == [10]


def test_a_life_that_left_nothing_is_not_missed(tmp_path: Path):
    keep_report(tmp_path, "edge")
    keep_report(tmp_path, "")
    assert list(tmp_path.iterdir()) == []
    assert summarise(tmp_path, RunConfig()) is None
    robot_life(tmp_path)
    result = summarise(tmp_path, RunConfig())
    assert result is not None
    assert result["edge_solve_ms"]["p50"] is None
