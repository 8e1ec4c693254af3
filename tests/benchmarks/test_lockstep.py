"""The benchmark of lockstep: its parts make up the whole, and its table has a line per trial."""

from __future__ import annotations

import pytest

from benchmarks import lockstep
from benchmarks.lockstep import TrialTime, timed_trial


@pytest.mark.parametrize("controller", ["pr", "lc"])
def test_the_parts_of_a_tick_make_up_the_time_played(controller):
    trial = timed_trial("balance", controller, seconds=0.1)
    assert trial.simulated == pytest.approx(0.1)
    assert min(trial.of_tick) > 0.0
    assert min(trial.built, trial.summed_up) > 0.0
    # The robot waits for its first answer, 25 ms and a few, before the task begins: more ticks.
    assert 0.1e3 < trial.played / sum(trial.of_tick) < 0.14e3


def test_trials_in_a_minute_count_all_of_a_trial():
    trial = TrialTime(simulated=5.0, built=0.5, played=2.0, summed_up=0.5, of_tick=(1.0,) * 6)
    assert trial.per_minute == 20.0


def test_the_table_has_a_line_for_each_task_and_controller(monkeypatch):
    played = []

    def made_up(task, controller, *, seconds):
        played.append((task, controller, seconds))
        return TrialTime(seconds, 0.5, 2.0, 0.5, (0.001, 0.002, 0.003, 0.004, 0.005, 0.006))

    monkeypatch.setattr(lockstep, "timed_trial", made_up)
    monkeypatch.setattr(lockstep, "header", lambda: "a machine")
    lines = lockstep.run(repetitions=2, seconds=5.0).splitlines()
    assert lines[0].startswith("a machine; trials of 5 s over constant:25ms, medians of 2")
    assert lines[-6].split() == [
        "balance,", "PR", "5.0", "20.0", "2.50",
        "1.000", "2.000", "3.000", "4.000", "5.000", "6.000", "21.000", "500", "500",
    ]  # fmt: skip
    assert [line.split()[:2] for line in lines[-6:]] == [
        [f"{task},", controller]
        for task in ("balance", "walk")
        for controller in ("PR", "LA", "LC")
    ]
    assert played.count(("walk", "la", 5.0)) == 2
