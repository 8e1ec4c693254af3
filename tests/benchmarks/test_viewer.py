"""The benchmark of the viewer: what it reads of a run, how it disturbs a process, its table."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks import timing, viewer
from benchmarks.viewer import CASES, Ticks, disturb, read_ticks
from shared.errors import ConfigError
from shared.process.entry import python
from shared.telemetry.parquet import write_parquet
from shared.telemetry.schema import Column, Schema
from tests.processes import ended, until

SCHEMA = Schema(*(Column(name) for name in ("time_ns", "tick_ns", "late_ns", "overruns")))


def telemetry(folder: Path, *, waiting: int, ticks: int, overruns: np.ndarray) -> Path:
    """A run whose k-th tick of the task computes k µs and is 2 k µs late."""
    rows = np.zeros((waiting + ticks, SCHEMA.width))
    k = np.arange(ticks)
    rows[:waiting, 0] = -1
    rows[:waiting, 1:] = 1e9
    rows[waiting:] = np.column_stack([k * 1e6, k * 1e3, k * 2e3, overruns])
    write_parquet(SCHEMA, rows, folder / "telemetry.parquet")
    return folder / "telemetry.parquet"


def test_the_wait_and_the_first_second_are_left_out(tmp_path: Path) -> None:
    overruns = np.where(np.arange(3001) < 500, 0, 4)
    overruns[2000:] = 7
    ticks = read_ticks(telemetry(tmp_path, waiting=300, ticks=3001, overruns=overruns))
    assert ticks.p50 == pytest.approx(2.0)
    assert ticks.p99 == pytest.approx(2.98)
    assert ticks.maximum == pytest.approx(3.0)
    assert ticks.late_p99 == pytest.approx(5.96)
    assert ticks.overruns == 3


@pytest.mark.parametrize(("waiting", "ticks"), [(1500, 0), (0, 900)])
def test_a_run_of_a_second_has_nothing_to_read(tmp_path: Path, waiting: int, ticks: int) -> None:
    file = telemetry(tmp_path, waiting=waiting, ticks=ticks, overruns=np.zeros(ticks))
    with pytest.raises(ConfigError, match="more than a second"):
        read_ticks(file)


def sleeper(seconds: float) -> subprocess.Popen[bytes]:
    command = python("-c", f"import time; time.sleep({seconds})")
    return subprocess.Popen(command, start_new_session=True)


def state_of(process: subprocess.Popen[bytes]) -> str:
    stat = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8")
    return stat.rpartition(")")[2].split()[0]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_viewer_gets_its_signals_in_turn_while_the_run_lasts() -> None:
    up, watching = sleeper(60.0), sleeper(60.0)
    try:
        began = time.monotonic()
        disturb(up, watching.pid, [(signal.SIGSTOP, 60.0)], seconds=0.1)
        until(lambda: state_of(watching) == "T", "it is not stopped")
        disturb(up, watching.pid, [(signal.SIGSTOP, 0.01), (signal.SIGCONT, 60.0)], seconds=0.2)
        until(lambda: state_of(watching) != "T", "it does not go on")
        up.kill()
        up.wait()
        disturb(up, watching.pid, [(signal.SIGKILL, 60.0)], seconds=60.0)
        assert ended(watching) == -signal.SIGKILL
        disturb(up, watching.pid, [(signal.SIGSTOP, 60.0)], seconds=60.0)
        # With the run, or with its own time: not with those of the signals.
        assert time.monotonic() - began < 50.0
    finally:
        for process in (up, watching):
            process.kill()
            process.wait()


def test_the_table_has_a_line_per_case_with_medians_spans_and_ratios(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    played: list[tuple[str, float]] = []

    def made_up(case: viewer.Case, *, seconds: float) -> Ticks:
        played.append((case.name, seconds))
        k, which = divmod(len(played) - 1, len(CASES))
        p99 = (0.4, 0.5, 0.8)[k] * (1.0, 1.1, 0.9, 1.0, 2.0)[which]
        return Ticks(p50=0.25, p99=p99, maximum=1.0 + k, late_p99=0.05, overruns=k)

    monkeypatch.setattr(viewer, "play", made_up)
    monkeypatch.setattr(viewer, "cores_busy", lambda *, seconds: 0.25)
    monkeypatch.setattr(timing, "machine", lambda: "a machine")
    lines = viewer.run(seconds=10.0, repetitions=3).splitlines()
    assert played[: len(CASES) + 1] == [
        *((case.name, 10.0) for case in CASES),
        (CASES[0].name, 10.0),
    ], "interleaved"
    assert lines[0] == "a machine, 25% of the cores busy before the start"
    table = lines[-len(CASES) :]
    assert [line[: len(case.name)] for line, case in zip(table, CASES, strict=True)] == [
        case.name for case in CASES
    ]
    assert table[-1].split("  ")[-1].strip() == "2.00 (2.00–2.00)"
    assert "0.250 (0.250–0.250)  1.000 (0.800–1.600)  2.000 (1.000–3.000)" in table[-1]
    assert "1 (0–2)" in table[-1]
