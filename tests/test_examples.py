"""The examples do what they say, short ones of their kind; and each is one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from examples import own_controller, own_plant, own_task, own_trace, sweep, trial
from netem.profile import LOST

FOLDER = Path(trial.__file__).parent
FILES = sorted(path for path in FOLDER.glob("*.py") if path.stem != "__init__")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_example_is_a_page_and_says_how_it_is_run(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert f"\n    ./deploy/python -m examples.{path.stem}\n" in text


def test_a_trial_plays_each_controller_and_says_what_happened(capsys):
    results = trial.main(duration=0.2)
    message = capsys.readouterr().out
    assert list(results) == ["pr", "la", "lc"]
    for name, result in results.items():
        assert result.summary["controller"] == name
        assert f"Stands after 0.20 s of balance with {name.upper()} over factory/011" in message


def test_with_the_last_solution_romeo_stands_where_pr_falls(capsys):
    # PR is on the floor 1.65 s after the start.
    pr, mine = own_controller.main(duration=1.8)
    assert pr.summary["fell"]
    assert not mine.summary["fell"]
    assert mine.summary["commands"]["cached"] == 1800
    assert "on the last solution Romeo stands after 1.80 s" in capsys.readouterr().out


def test_a_trace_from_an_array_is_what_messages_meet(tmp_path, capsys):
    profile, result = own_trace.main(duration=0.3, folder=tmp_path)
    np.testing.assert_array_equal(profile.delays_ns, own_trace.my_link().delays_ns)
    _, lost = np.nonzero(profile.delays_ns == LOST)
    assert len(lost) == 20
    downlink = result.summary["link"]["downlink"]
    # Of the answers of 0.3 s, and of the few before the first one was there.
    assert downlink["dropped_by_profile"] in (3, 4)
    assert downlink["nominal_delay_ms"]["p50"] == 5.0
    assert str(tmp_path / "mine.csv") in capsys.readouterr().out


def test_knee_bends_go_as_deep_as_they_are_asked_to(capsys):
    result = own_task.main(duration=1.0)
    height = result.schema.column(result.rows, "com")[:, 2]
    # The gain leaves some millimetres of the 60.
    assert height[0] - height[-1] == pytest.approx(own_task.DEPTH, abs=0.005)
    assert "stands" in capsys.readouterr().out


def test_a_sweep_has_a_row_per_trial_and_goes_on_where_it_was(tmp_path, capsys):
    rows = sweep.main(duration=0.02, folder=tmp_path, workers=1)
    seeds, grid = sweep.STUDY["seeds"], sweep.STUDY["grid"]
    assert len(rows) == seeds * len(grid["controller"]) * len(grid["link.network"])
    assert all(row["error"] is None for row in rows)
    played = (tmp_path / "sweep-delays" / "trials.jsonl").read_bytes()
    assert sweep.main(duration=0.02, folder=tmp_path, workers=1) == rows
    assert (tmp_path / "sweep-delays" / "trials.jsonl").read_bytes() == played
    assert "constant:120ms" in capsys.readouterr().out


def test_the_robot_of_somebody_elses_model_stands_on_old_answers() -> None:
    result = own_plant.main(duration=1.5)
    assert not result.summary["fell"]
    assert result.summary["projector_age_ms"]["p50"] > 100
