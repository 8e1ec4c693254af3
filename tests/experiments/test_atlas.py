"""The map of falls: what it plays, counts and refuses."""

from __future__ import annotations

import argparse

import pyarrow.parquet as pq
import pytest

from experiments import atlas
from experiments.atlas import add_atlas_arguments, in_words, run_atlas, squares_of, study_from
from experiments.studies.trial_table import read_trials
from shared.errors import ConfigError


def parsed(*arguments):
    parser = argparse.ArgumentParser()
    add_atlas_arguments(parser)
    return parser.parse_args([str(each) for each in arguments])


@pytest.fixture
def short(tmp_path):
    """Options of the shortest map: two delays, two pushes, one controller."""
    file = tmp_path / "short.toml"
    file.write_text('duration = 0.05\nseed = 7\nplant.friction = 0.6\npush = ["1N@0s:1s:+x"]\n')
    return (
        "--config", file, "--controllers", "la", "--delays", "4ms,0ms", "--pushes", "0N,900N",
        "--push-at", "10ms", "--push-for", "20ms", "--seeds", 1, "--workers", 1,
        "--out", tmp_path / "out",
    )  # fmt: skip


def test_a_map_is_played_drawn_and_resumed(short, tmp_path, capsys):
    assert run_atlas(parsed(*short)) == 0
    out = tmp_path / "out"
    printed = capsys.readouterr().out
    assert (out / "atlas.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "atlas.txt").read_text().strip() in printed
    squares = pq.read_table(out / "atlas.parquet").to_pylist()
    assert [(s["force"], s["delay_ns"], s["played"]) for s in squares] == [
        (900.0, 0, 1), (0.0, 0, 1), (900.0, 4_000_000, 1), (0.0, 4_000_000, 1)
    ]  # fmt: skip
    trials = read_trials(out)
    lines = (out / "trials.jsonl").read_bytes()
    assert run_atlas(parsed(*short)) == 0
    assert (out / "trials.jsonl").read_bytes() == lines
    assert read_trials(out) == trials


def test_the_file_and_the_flags_reach_every_trial(short):
    configs = [trial.config for trial in study_from(parsed(*short)).trials]
    assert {config.plant.friction for config in configs} == {0.6}
    assert {config.duration for config in configs} == {0.05}
    assert {config.seed for config in configs} == {0}
    assert {config.push for config in configs} == {
        ("900N@0.01s:0.02s:+y",), ("0N@0.01s:0.02s:+y",)
    }  # fmt: skip


def test_a_walk_is_pushed_within_a_step():
    trials = study_from(parsed("--task", "walk", "--direction=-x", "--seeds", 1)).trials
    assert len(trials) == 3 * 8 * 8
    assert {trial.config.task for trial in trials} == {"walk"}
    assert "100N@3s:0.2s:-x" in {trial.config.push[0] for trial in trials}


def test_a_task_of_ones_own_is_pushed_as_a_balance():
    study = study_from(parsed("--task", "shared.motion.plan:standing", "--seeds", 1))
    assert study.name == "atlas-standing"
    assert {trial.config.task for trial in study.trials} == {"shared.motion.plan:standing"}
    assert "40N@1s:0.2s:+y" in {trial.config.push[0] for trial in study.trials}


def row(fell, *, controller="la", delay="25ms", force="60N", error=None):
    return {
        "controller": controller, "link.network": f"constant:{delay}",
        "push": [f"{force}@1s:0.2s:+y"], "fell": fell, "error": error,
    }  # fmt: skip


def test_a_square_counts_those_that_fell_of_those_played():
    rows = [row(True), row(False), row(False), row(None, error="no"), row(False, force="40N")]
    first, second = squares_of(rows)
    assert (first["fell"], first["played"], first["p_fall"]) == (1, 3, pytest.approx(1 / 3))
    # Wilson's interval of 1 of 3.
    assert (first["low"], first["high"]) == pytest.approx((0.0615, 0.7923), abs=1e-4)
    assert (second["force"], second["fell"], second["played"]) == (40.0, 0, 1)
    assert squares_of([row(None, error="no")])[0]["p_fall"] is None


def test_the_words_have_a_line_per_push_and_a_column_per_delay():
    rows = [row(True, delay="400ms"), row(False), row(False, controller="pr", delay="400ms")]
    lines = in_words(squares_of([*rows, row(True, controller="pr")])).splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["25", "ms", "400", "ms"],
        ["LA", "60", "N", "0/1", "1/1"],
        ["PR", "60", "N", "1/1", "0/1"],
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--controllers", "la,mpc"), "--controllers: expected one of la, lc, pr, got 'mpc'"),
        (("--controllers", "la,la"), "--controllers: expected each value once, got 'la' twice"),
        (("--delays", "10ms,fast"), "--delays: expected a duration as in 30ms.*got 'fast'"),
        (("--delays", "50ms,0.05s"), "--delays: expected each value once, got '0.05s' twice"),
        (("--pushes", "60"), "--pushes: expected forces as in 60N, got '60'"),
        (("--pushes", ""), "--pushes: expected forces as in 60N, got ''"),
        (("--direction", "left"), "--direction: expected ±x, ±y or ±z, got 'left'"),
        (("--push-at", "9s"), "--push-at: expected before the end at 5 s, got 9s"),
        (("--push-for", "long"), "--push-for: expected a duration.*got 'long'"),
        (("--seeds", "0"), "seeds: expected a number of at least 1, got 0"),
        (("--task", "run"), "task: expected one of balance, walk, go, got 'run'"),
        (("--robot", "juliet"), "robot: expected one of g1, icub, romeo, talos, got 'juliet'"),
        (("--workers", "0"), "--workers: expected at least 1, got 0"),
        (("--workers", "1", "--scheduler", "tcp://a:1"), "--workers: expected without"),
        (("--config", "nowhere.toml"), "config: cannot read nowhere.toml"),
    ],
)
def test_a_value_that_cannot_be_is_refused_before_anything_is_played(
    arguments, message, monkeypatch
):
    monkeypatch.setattr(atlas, "sweep", lambda *_, **__: pytest.fail("played"))
    with pytest.raises(ConfigError, match=message):
        run_atlas(parsed(*arguments))
