"""Figures of finished sweeps, and of corrections without a simulation."""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from matplotlib import pyplot as plt

from experiments.figure import FELL, _draw, _value, add_figure_arguments, run_figure
from experiments.studies.corrections import run_corrections
from experiments.studies.study_file import read_study
from experiments.studies.sweep import sweep
from shared.errors import ConfigError

PNG = b"\x89PNG"
STUDY = """
seeds = 1

[base]
duration = 0.03
push = []
link.network = "constant:0ms"

[grid]
controller = ["lc", "la"]
plant.friction = [0.6, 0.8]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figure")
    (folder / "short.toml").write_text(STUDY)
    sweep(read_study(folder / "short.toml"), out=folder / "out")
    return folder / "out"


@pytest.fixture
def figure():
    parser = argparse.ArgumentParser()
    add_figure_arguments(parser)
    return lambda *arguments: run_figure(parser.parse_args([str(each) for each in arguments]))


def test_a_figure_has_a_panel_and_a_line_for_each_value(finished, figure, tmp_path):
    out = tmp_path / "new" / "figure.png"
    assert (
        figure(
            finished, "--x", "plant.friction", "--by", "controller", "--panels", "controller",
            "--y", "stood", "--y", "com_error_m", "--out", out,
        )
        == 0
    )  # fmt: skip
    assert out.read_bytes().startswith(PNG)


def test_a_line_keeps_the_order_of_all_values_where_a_group_has_none():
    axis = plt.figure().add_subplot()
    stands = {"fell": False, "error": None, "com_error_m": 0.01}
    _draw(axis, ["a", "b", "c"], {"c": [stands], "a": [stands]}, "com_error_m", "line")
    ((line, *_),) = axis.containers
    assert line.get_xdata().tolist() == [0, 1, 2]
    drawn = np.asarray(line.get_ydata(), dtype=float)
    np.testing.assert_array_equal(drawn, [0.01, np.nan, 0.01])
    assert [tick.get_text() for tick in axis.get_xticklabels()] == ["a", "b", "c"]
    plt.close()


def test_a_map_has_a_square_for_each_pair_of_values(finished, figure, tmp_path):
    out = tmp_path / "map.png"
    arguments = ("--x", "plant.friction", "--by", "controller", "--map", "--out", out)
    assert figure(finished, *arguments) == 0
    assert out.read_bytes().startswith(PNG)


def test_falls_are_counted_like_those_standing(finished, figure, tmp_path):
    out = tmp_path / "falls.png"
    assert figure(finished, "--x", "plant.friction", "--y", "fell", "--out", out) == 0
    counted = _value([{"fell": True, "error": None}, {"fell": None, "error": "no"}], FELL)
    assert counted is not None
    assert counted[2] == "1/1"
    assert _value([{"fell": None, "error": "no"}], FELL) is None


def test_an_unknown_column_is_named_with_those_that_exist(finished, figure, tmp_path):
    with pytest.raises(ConfigError, match=r"plant\.friction.*got 'frictoin'"):
        figure(finished, "--x", "frictoin", "--out", tmp_path / "f.png")


def test_a_folder_without_a_sweep_is_refused(figure, tmp_path):
    with pytest.raises(ConfigError, match="finished sweep"):
        figure(tmp_path, "--x", "seed", "--out", tmp_path / "f.png")


def test_corrections_come_with_their_command_and_versions(tmp_path):
    assert run_corrections(argparse.Namespace(out=tmp_path, states=2, seed=0)) == 0
    assert (tmp_path / "corrections.png").read_bytes().startswith(PNG)
    text = (tmp_path / "corrections.md").read_text()
    assert "./wbc corrections --states 2 --seed 0" in text
    assert text.count("support |") == 14


PUSHES = """
seeds = 1

[base]
duration = 0.03
link.network = "constant:0ms"

[grid]
push = [["10N@0s:0.01s:+x"], ["20N@0s:0.01s:-x+y"]]
"""


def test_pushes_are_drawn_at_their_force_in_their_direction(figure, tmp_path, monkeypatch):
    (tmp_path / "pushes.toml").write_text(PUSHES)
    sweep(read_study(tmp_path / "pushes.toml"), out=tmp_path / "out")
    drawn = []
    monkeypatch.setattr(
        "matplotlib.projections.polar.PolarAxes.scatter",
        lambda axis, angle, radius, **_: drawn.append((angle, radius)),
    )
    out = tmp_path / "polar.png"
    assert figure(tmp_path / "out", "--x", "push", "--polar", "--out", out) == 0
    assert out.read_bytes().startswith(PNG)
    np.testing.assert_allclose(drawn, [(0.0, 10.0), (0.75 * np.pi, 20.0)])


def test_a_polar_figure_of_another_setting_is_refused(finished, figure, tmp_path):
    with pytest.raises(ConfigError, match=r"expected --x push with --polar, got 'controller'"):
        figure(finished, "--x", "controller", "--polar", "--out", tmp_path / "no.png")
